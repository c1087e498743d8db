#!/usr/bin/env python3
"""Noise and analysis by others beside this program's: do both directions give the same curves and parameters?

    cargo build --release && python3 tests/peers/independent_noise.py [--records 16] [--binary target/release/vn100d]

(a) White noise and random walks of allantools with flicker noise of colorednoise, written as CSV and analysed by
    `vn100d noise` and `vn100d allan`: the 95 % intervals hold the truth as often as they say, and curves and parameters
    are those of `vn100d simulate` with the same model.
(b) `vn100d simulate` analysed by allantools and allan-variance gives the model's parameters and closed form.

The packages go into a virtual environment of their own, target/peers/independent, which is made when it is missing.
Seeds are fixed, and the generators are those that NumPy has frozen. Every line that decides has the probability of a
result as far off or farther; the check fails (exit code 1) where one is below ALPHA divided by the number of such
lines, which happens to a program without fault in one of a hundred choices of the seeds.
"""

import argparse
import concurrent.futures
import functools
import json
import os
import pathlib
import subprocess
import sys
import tempfile
import time
import venv

ROOT = pathlib.Path(__file__).resolve().parent.parent.parent
HOME = ROOT / "target" / "peers" / "independent"
PYTHON = HOME / "venv" / "bin" / "python"
# What they compute with; what else allantools and allan-variance name serves their documentation and plots.
NUMERIC = ["numpy>=2", "scipy", "pandas"]
PACKAGES = ["allantools==2024.6", "colorednoise==2.2.0", "allan-variance==1.0"]

RATE_HZ = 40.0
LENGTH_S = 18_000.0
COUNT = int(RATE_HZ * LENGTH_S)
# N in U/√Hz, B in U, K in U/√s (docs/noise-model.md).
TRUTH = {
    "gyro": {"N": 1.2e-4, "B": 2.6e-5, "K": 1.5e-6},
    "accel": {"N": 0.0021, "B": 0.0011, "K": 3.2e-4},
}
UNITS = {"gyro": "rad_s", "accel": "m_s2"}
CHANNELS = [f"{triad}_{axis}" for triad in TRUTH for axis in "xyz"]
# A flicker record is a part of one so many times as long: colorednoise's has nothing below one over its length, and its
# end joins its beginning.
LONGER = 4
# 2^0 … 2^17: of longer averaging times a record of 720,000 samples holds fewer than three.
FACTORS = [1 << k for k in range(18)]
# Averaging times that allan-variance fits: its flicker noise has no Nyquist frequency, which tells below ten samples.
FIT_FROM_S, FIT_TIMES = 0.25, 30
# Three channels of a kind to a record: with fewer the covariance of a whole curve is singular.
FEWEST = 4
# Two programs' Allan deviations of one file.
SAME = 1e-6
ALPHA = 0.01


def main():
    options = arguments()
    if not options.binary.exists():
        sys.exit(f"{options.binary} is missing: run `cargo build --release` first, or name it with --binary")
    HOME.mkdir(parents=True, exist_ok=True)
    if not PYTHON.exists():
        venv.create(HOME / "venv", with_pip=True)
    wanted = "import allantools, colorednoise, allan_variance"
    if subprocess.run([PYTHON, "-c", wanted], stderr=subprocess.DEVNULL).returncode != 0:
        install = [PYTHON, "-m", "pip", "install", "--quiet"]
        subprocess.run([*install, *NUMERIC], check=True)
        subprocess.run([*install, "--no-deps", *PACKAGES], check=True)
    # A process per core makes records; threads within would only be in each other's way.
    one = {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")}
    measure = [PYTHON, __file__, "--measure", "--records", str(options.records), "--binary", options.binary]
    sys.exit(subprocess.run(measure, env={**os.environ, **one}).returncode)


def arguments():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--records", type=int, default=16, help="of six channels each, from either side")
    parser.add_argument("--binary", type=pathlib.Path, default=ROOT / "target" / "release" / "vn100d")
    parser.add_argument("--measure", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.records < FEWEST:
        parser.error(f"--records {options.records}: at least {FEWEST}, for more channels than averaging times")
    return options


# Their noise


def their_channel(random, n, b, k):
    """One channel: allantools draws from NumPy's global generator, colorednoise from `random`.

    White: `white(b0)` has the one-sided density b0, that is twice the two-sided N²: b0 = 2 N².

    Random walk: `brown(b_minus2)` has the one-sided density b_minus2/f², and the two-sided one is (K/2πf)²:
    b_minus2 = 2 (K/2π)² = K²/2π². (Its steps have the variance K²/rate, as those of a sampled Wiener process.)

    Flicker: `powerlaw_psd_gaussian(1, n)` draws X_k at f_k = k/n cycles per sample, k = 1 … n/2, with E|X_k|² = 2/f_k
    (real and imaginary part 1/f_k each), and divides the inverse transform by sigma. The two-sided density of samples
    at intervals of dt is dt·E|X_k|²/n, here 2 dt/(n f_k sigma²); that of B is B²/(2π·f_k/dt). With a factor c they
    agree for c² = B² n sigma²/4π, at every frequency up to Nyquist.
    """
    import allantools
    import colorednoise
    import numpy

    white = allantools.noise.white(COUNT, b0=2 * n**2, fs=RATE_HZ)
    walk = allantools.noise.brown(COUNT, b_minus2=k**2 / (2 * numpy.pi**2), fs=RATE_HZ)
    length = LONGER * COUNT
    # As colorednoise computes it; the last term is at Nyquist, for even n half of w.
    w = numpy.sqrt(1 / numpy.fft.rfftfreq(length)[1:])
    w[-1] *= (1 + length % 2) / 2
    sigma = 2 * numpy.sqrt(numpy.sum(w**2)) / length
    c = b * numpy.sqrt(length / (4 * numpy.pi)) * sigma
    flicker = c * colorednoise.powerlaw_psd_gaussian(1, length, random_state=random)[:COUNT]
    return white + flicker + walk


def their_record(seed, path):
    import numpy

    numpy.random.seed(seed)
    random = numpy.random.RandomState(10_000 + seed)
    columns = [numpy.arange(COUNT) / RATE_HZ]
    for channel in CHANNELS:
        truth = TRUTH[channel.split("_")[0]]
        columns.append(their_channel(random, truth["N"], truth["B"], truth["K"]))
    header = ",".join(["time_s", *(f"{channel}_{UNITS[channel.split('_')[0]]}" for channel in CHANNELS)])
    text = ["%.3f"] + ["%.9g"] * len(CHANNELS)
    numpy.savetxt(path, numpy.transpose(columns), delimiter=",", fmt=text, header=header, comments="")


# This program


def model(parameters):
    document = {"format": "vn100d-sensor-model-1", "name": "independent check", "rate_hz": RATE_HZ}
    return document | {"channels": {channel: parameters(channel) for channel in CHANNELS}}


def whole(channel):
    return TRUTH[channel.split("_")[0]]


def one_each(channel):
    """N on x, B on y, K on z, nothing else."""
    triad, axis = channel.split("_")
    letter = "NBK"["xyz".index(axis)]
    return {letter: TRUTH[triad][letter]}


def our_record(binary, seed, parameters, path):
    path.with_suffix(".json").write_text(json.dumps(model(parameters)))
    words = ["--duration", f"{LENGTH_S:.0f}s", "--seed", str(seed), "--out", path]
    simulate = [binary, "simulate", "--model", path.with_suffix(".json"), *words]
    subprocess.run(simulate, check=True, stdout=subprocess.DEVNULL)


def told(binary, *words):
    return json.loads(subprocess.run([binary, *words, "--json"], check=True, stdout=subprocess.PIPE).stdout)["channels"]


# A record each


def columns_of(path):
    import pandas

    frame = pandas.read_csv(path)
    return {channel: frame[f"{channel}_{UNITS[channel.split('_')[0]]}"].to_numpy() for channel in CHANNELS}


def oadev(samples, factors):
    """Overlapping Allan variances by allantools."""
    import allantools
    import numpy

    times = numpy.array(factors) / RATE_HZ
    found, deviation, _, _ = allantools.oadev(samples, rate=RATE_HZ, data_type="freq", taus=times)
    if len(found) != len(factors):
        raise SystemExit("allantools left averaging times out")
    return deviation**2


def analysed(work):
    """One record of `whose` noise with all three terms, analysed by everyone."""
    import allan_variance
    import numpy

    binary, whose, seed = work
    with tempfile.TemporaryDirectory(dir=HOME) as folder:
        path = pathlib.Path(folder) / "record.csv"
        if whose == "their":
            their_record(seed, path)
        else:
            our_record(binary, seed, whole, path)
        noise = told(binary, "noise", path)
        curves = told(binary, "allan", path, "--taus", "octave")
        samples = columns_of(path)
    record = {}
    for channel in CHANNELS:
        curve = curves[channel]
        factors = [round(tau * RATE_HZ) for tau in curve["tau_s"]]
        of = {
            "noise": noise[channel],
            "variance": [curve["deviation"][factors.index(m)] ** 2 for m in FACTORS],
            "edf": [curve["edf"][factors.index(m)] for m in FACTORS],
            "allantools": oadev(samples[channel], FACTORS),
        }
        if whose == "our":
            fit = {"tau_min": FIT_FROM_S, "n_clusters": FIT_TIMES}
            of["fit"] = allan_variance.compute_avar(samples[channel], 1 / RATE_HZ, **fit)
        record[channel] = of | {"apart": numpy.max(numpy.abs(numpy.sqrt(of["allantools"] / of["variance"]) - 1))}
    return whose, record


# Where N, B and K are read off a curve that has nothing else: τ = 1 s, anywhere on the floor, and τ = 3 s, where
# K√(τ/3) is K; slopes from the second to the third.
READ_AT = {"N": (40, 40, 400), "B": (400, 40, 4000), "K": (120, 40, 4000)}


def read_off(work):
    """One record of this program's with one term to a channel: variances at the factors of READ_AT, by allantools."""
    binary, seed = work
    with tempfile.TemporaryDirectory(dir=HOME) as folder:
        path = pathlib.Path(folder) / "record.csv"
        our_record(binary, seed, one_each, path)
        samples = columns_of(path)
    variances = {}
    for channel in CHANNELS:
        (letter,) = one_each(channel)
        factors = sorted(set(READ_AT[letter]))
        variances[channel] = dict(zip(factors, oadev(samples[channel], factors)))
    return variances


# What it should be


def closed_form(n, b, k, m):
    """Allan variance of N, B and K sampled at RATE_HZ, at the averaging factor m: the integral of the two-sided density
    up to Nyquist under 2 sin⁴(πfτ)/(m sin πf·dt)²."""
    tau_s = m / RATE_HZ
    return n**2 / tau_s + b**2 * flicker_form(m) + k**2 / RATE_HZ * (2 * m**2 + 1) / (6 * m)


@functools.cache
def flicker_form(m):
    """(2/πm²) ∫ sin⁴(mx)/(x sin²x) dx from 0 to π/2, with x = πf·dt; (2 ln 2)/π for large m."""
    import numpy
    import scipy.integrate

    # The integrand ripples with π/m below 1/x³: Simpson's rule with 64 panels to a ripple, so many ripples at a time.
    total, ripples = 0.0, 4096
    edges = numpy.linspace(0, numpy.pi / 2, max(1, m // ripples) + 1)
    for low, high in zip(edges[:-1], edges[1:]):
        x = numpy.linspace(low, high, 64 * min(m, ripples) + 1)
        y = numpy.zeros_like(x)
        inner = x > 0
        y[inner] = numpy.sin(m * x[inner]) ** 4 / (x[inner] * numpy.sin(x[inner]) ** 2)
        total += scipy.integrate.simpson(y, x=x)
    return 2 / (numpy.pi * m**2) * total


class Judgement:
    """Lines that decide, each with its probability."""

    def __init__(self):
        self.lines = []

    def take(self, name, probability):
        self.lines.append((name, probability))
        return f"{probability:9.2g}"

    def require(self, name, holds):
        return self.take(name, 1.0 if holds else 0.0)

    def failed(self):
        return [name for name, probability in self.lines if not probability >= ALPHA / len(self.lines)]


def heading(text):
    print(f"\n{text}")


def measure():
    options = arguments()
    begun = time.perf_counter()
    whole_work = [(options.binary, whose, 1000 + i) for whose in ("their", "our") for i in range(options.records)]
    single_work = [(options.binary, 2000 + i) for i in range(options.records)]
    with concurrent.futures.ProcessPoolExecutor(os.cpu_count()) as pool:
        wholes = list(pool.map(analysed, whole_work))
        singles = list(pool.map(read_off, single_work))
    sets = {}
    for whose, record in wholes:
        for channel, of in record.items():
            sets.setdefault((whose, channel.split("_")[0]), []).append(of)

    judge = Judgement()
    print(f"{options.records} records from either side, 5 h at 40 Hz, three gyro and three accelerometer channels each")
    print("their: allantools (white noise, random walk) and colorednoise (flicker); our: vn100d simulate")
    print("p: probability of a result as far off or farther")
    intervals(sets, judge)
    parameters(sets, judge)
    curves(sets, judge)
    same_estimator(sets, judge)
    against_closed_form(sets, judge)
    readings(singles, judge)
    their_fit(sets, judge)

    failed = judge.failed()
    verdict = "FAILED " + "; ".join(failed) if failed else "all hold"
    count, took_s = len(judge.lines), time.perf_counter() - begun
    print(f"\n{count} criteria, threshold p = {ALPHA / count:.1e}, {took_s:.0f} s: {verdict}")
    sys.exit(1 if failed else 0)


def intervals(sets, judge):
    import scipy.stats

    heading("(a) vn100d noise: 95 % intervals (named) or limits (not named) that hold the truth; p of so few")
    print("noise  triad   named  intervals     limits     together           p  flags Q, R, GM named")
    total, hold = 0, 0
    for (whose, triad), channels in sets.items():
        for letter in "NBK":
            truth, held, limited, named = TRUTH[triad][letter], 0, 0, 0
            for of in channels:
                found = of["noise"][letter]
                if found["identified"]:
                    named += 1
                    held += found["ci95"][0] <= truth <= found["ci95"][1]
                else:
                    limited += truth <= found["upper_limit95"]
            count = len(channels)
            total, hold = total + count, hold + held + limited
            name = f"intervals of {letter}, {whose} {triad}"
            p = judge.take(name, scipy.stats.binom.cdf(held + limited, count, 0.95))
            text = f"{whose:6} {triad:6} {letter} {named:3}  {held:4} of {named:3} {limited:4} of {count - named:3}"
            text += f" {held + limited:4} of {count} = {(held + limited) / count:.3f} {p}"
            if letter == "N":
                flagged = sum(bool(of["noise"].get("flags")) for of in channels)
                other = [sum(bool(of["noise"][what]["identified"]) for of in channels) for what in "QR"]
                other.append(sum(of["noise"]["gauss_markov"] is not None for of in channels))
                text += f"  {flagged:5} {', '.join(map(str, other))}"
            print(text)
    p = judge.take("all intervals", scipy.stats.binomtest(hold, total, 0.95).pvalue)
    print(f"all                                           {hold} of {total} = {hold / total:.3f} {p} (to either side)")


def parameters(sets, judge):
    import numpy
    import scipy.stats

    heading("(a) fitted parameters where named, their noise against ours (Welch)")
    print("triad     truth      their mean ± error      our mean ± error     our/their ± error          p")
    for triad in TRUTH:
        for letter in "NBK":
            samples = []
            for whose in ("their", "our"):
                found = [of["noise"][letter] for of in sets[whose, triad]]
                samples.append(numpy.array([one["value"] for one in found if one["identified"]]))
            mean = [values.mean() for values in samples]
            error = [values.std(ddof=1) / len(values) ** 0.5 for values in samples]
            ratio = mean[1] / mean[0]
            off = ratio * numpy.hypot(error[0] / mean[0], error[1] / mean[1])
            p = judge.take(f"fitted {letter}, {triad}", scipy.stats.ttest_ind(*samples, equal_var=False).pvalue)
            each = "  ".join(f"{value:.4e} ± {spread:.1e}" for value, spread in zip(mean, error))
            print(f"{triad:6} {letter} {TRUTH[triad][letter]:.2e}  {each}  {ratio:.4f} ± {off:.4f} {p}")


def curves(sets, judge):
    import numpy
    import scipy.stats

    heading("(a) vn100d allan: mean Allan variances, their noise against ours (F test, the curves' degrees of freedom)")
    print("               gyro: our/their ± error         z          p   accel: our/their ± error         z          p")
    lines = {m: f"τ {m / RATE_HZ:9.3f} s" for m in FACTORS}
    for triad in TRUTH:
        means, degrees = {}, {}
        for whose in ("their", "our"):
            means[whose] = numpy.mean([of["variance"] for of in sets[whose, triad]], axis=0)
            degrees[whose] = numpy.sum([of["edf"] for of in sets[whose, triad]], axis=0)
        for i, m in enumerate(FACTORS):
            ratio = means["our"][i] / means["their"][i]
            one, other = degrees["our"][i], degrees["their"][i]
            z, probability = both_sides(scipy.stats.f(one, other), ratio)
            p = judge.take(f"curve of {triad} at {m / RATE_HZ:g} s", probability)
            lines[m] += f"     {ratio:8.4f} ± {numpy.sqrt(2 / one + 2 / other):6.4f} {z:+13.2f} {p}"
    print("\n".join(lines.values()))
    for triad in TRUTH:
        # All averaging times at once, with the covariance that the records themselves show (Hotelling).
        one, other = (numpy.log([of["variance"] for of in sets[whose, triad]]) for whose in ("our", "their"))
        count, width = len(one) + len(other), len(FACTORS)
        pooled = ((len(one) - 1) * numpy.cov(one.T) + (len(other) - 1) * numpy.cov(other.T)) / (count - 2)
        off = one.mean(axis=0) - other.mean(axis=0)
        t2 = len(one) * len(other) / count * off @ numpy.linalg.solve(pooled, off)
        f = t2 * (count - width - 1) / ((count - 2) * width)
        p = judge.take(f"whole curve of {triad}", scipy.stats.f.sf(f, width, count - width - 1))
        print(f"{triad}: the whole curve, Hotelling T² {t2:.1f} of {width} averaging times, F {f:.2f}, p {p.strip()}")


def same_estimator(sets, judge):
    apart = max(of["apart"] for channels in sets.values() for of in channels)
    judge.require("one file's curve by vn100d and by allantools", apart <= SAME)
    heading(f"One file's deviations by vn100d allan and allantools.oadev are apart by {apart:.1e} ({SAME:.0e} allowed)")


def both_sides(distribution, value):
    """The value as a normal deviate, and the probability of one as far off to either side."""
    import scipy.stats

    below, above = distribution.cdf(value), distribution.sf(value)
    z = scipy.stats.norm.isf(above) if above < below else scipy.stats.norm.ppf(below)
    return z, min(1.0, 2 * min(below, above))


def chi_squared(ratio, edf):
    """`both_sides` of a variance over its expectation."""
    import scipy.stats

    return both_sides(scipy.stats.chi2(edf), ratio * edf)


def against_closed_form(sets, judge):
    import numpy

    heading("(b) vn100d simulate by allantools.oadev: mean Allan variances over the model's closed form (chi-squared)")
    print("            gyro: found/model ± error         z          p   accel: found/model ± error        z          p")
    lines = {m: f"τ {m / RATE_HZ:9.3f} s" for m in FACTORS}
    for triad in TRUTH:
        channels = sets["our", triad]
        mean = numpy.mean([of["allantools"] for of in channels], axis=0)
        degrees = numpy.sum([of["edf"] for of in channels], axis=0)
        for m, found, edf in zip(FACTORS, mean, degrees):
            ratio = found / closed_form(*TRUTH[triad].values(), m)
            z, probability = chi_squared(ratio, edf)
            p = judge.take(f"our {triad} by allantools at {m / RATE_HZ:g} s", probability)
            lines[m] += f"     {ratio:8.4f} ± {numpy.sqrt(2 / edf):6.4f} {z:+13.2f} {p}"
    print("\n".join(lines.values()))


def readings(singles, judge):
    import allantools
    import numpy
    import scipy.stats

    heading("(b) vn100d simulate of one term, read off allantools.oadev: N at 1 s, B = floor/0.664, K at 3 s; slopes")
    print("channel     truth         found ± error   found/truth          p     slope ± error  expected          p")
    # Flat at √(2 ln 2/π) B, which is 0.664 B.
    floor = numpy.sqrt(2 * numpy.log(2) / numpy.pi)
    for channel in CHANNELS:
        ((letter, truth),) = one_each(channel).items()
        at, low, high = READ_AT[letter]
        alpha, scale, expected = {"N": (0, 1.0, -0.5), "B": (-1, 1 / floor, 0.0), "K": (-2, 1.0, 0.5)}[letter]
        # Variances are averaged, not deviations, whose mean is too small by a quarter of their squared spread.
        square = scale**2 * numpy.mean([of[channel][at] for of in singles])
        edf = len(singles) * allantools.edf_greenhall(alpha, 2, at, COUNT + 1, overlapping=True)
        found, error = square**0.5, square**0.5 / (2 * edf) ** 0.5
        p = judge.take(f"{letter} read off, {channel}", chi_squared(square / truth**2, edf)[1])
        slopes = [0.5 * numpy.log(of[channel][high] / of[channel][low]) / numpy.log(high / low) for of in singles]
        slope, spread = numpy.mean(slopes), numpy.std(slopes, ddof=1) / len(slopes) ** 0.5
        p_slope = judge.take(f"slope of {letter}, {channel}", scipy.stats.ttest_1samp(slopes, expected).pvalue)
        print(
            f"{channel:7} {letter} {truth:.2e}  {found:.4e} ± {error:.1e}   {found / truth:11.4f} {p}"
            f"   {slope:+.4f} ± {spread:.4f}     {expected:+.1f} {p_slope}"
        )


def their_fit(sets, judge):
    import allan_variance
    import numpy
    import scipy.stats

    heading("(b) vn100d simulate by allan-variance: estimate_parameters of the mean variances (jackknife)")
    print("triad     truth       found ± error    found/truth          p")
    effects = {"N": "white", "B": "flicker", "K": "walk"}
    for triad in TRUTH:
        channels = sets["our", triad]
        tau_s = channels[0]["fit"][0]
        variances = numpy.array([of["fit"][1] for of in channels])
        count = len(channels)

        def fitted(mean):
            found, _ = allan_variance.estimate_parameters(tau_s, mean, effects=list(effects.values()))
            return numpy.array([found[effect] for effect in effects.values()])

        found = fitted(variances.mean(axis=0))
        without = numpy.array([fitted((variances.sum(axis=0) - one) / (count - 1)) for one in variances])
        error = numpy.sqrt((count - 1) * numpy.var(without, axis=0))
        for letter, value, off in zip(effects, found, error):
            truth = TRUTH[triad][letter]
            probability = 2 * scipy.stats.t.sf(abs(value - truth) / off, count - 1)
            p = judge.take(f"{letter} by allan-variance, {triad}", probability)
            print(f"{triad:6} {letter} {truth:.2e}  {value:.4e} ± {off:.1e}   {value / truth:9.4f} {p}")


if __name__ == "__main__":
    measure() if "--measure" in sys.argv else main()
