#!/usr/bin/env python3
"""Other methods beside this program on its frozen set: do they see a gap, on the right channel, by the right name?

    cargo build --release
    python3 tests/peers/sim_to_real.py [--cases 1000] [--ours DIR] [--binary target/release/vn100d]

DIR is what `vn100d trial --suite 2026 --out DIR` wrote. The script gets each case's recording and model from
`vn100d trial-part case`, runs four methods on them, and opens the keys when it has the last answer. Then it counts the
same things of all methods and prints the tables of docs/benchmark.md. target/peers/sim_to_real keeps the answers: a run
that was broken off goes on, and a second run with --ours only counts. --fresh makes the answers again.

whiteness  Ljung and Box (Biometrika 65, 1978) at 20 and 500 lags of the whitened residual, McLeod and Li (J. Time Ser.
           Anal. 4, 1983) on its squares, Jarque and Bera (Int. Stat. Rev. 55, 1987), mean squares of 64 blocks.
gmwm       Haar wavelet variances fitted by generalised least squares, candidates ranked by fit and penalty, a test of
           fit: Guerrier, Skaloud, Stebler and Victoria-Feser (JASA 108, 2013).
c2st       Classifier two-sample test of windows of recording and simulation: Lopez-Paz and Oquab (ICLR 2017).
allan      Slopes and humps of the Allan deviation against the model's, with bands: IEEE Std 952, annex C.

No method sees a key. Every method gets the model with N, B and K refitted by Whittle's likelihood, and everything that
the model declares. Thresholds come from records without a gap: `vn100d simulate` makes them from the refitted models of
the same cases (all models with effects, every third without), and the whole method runs on each. A method may raise a
false alarm in ALPHA of the records. Seeds are fixed. The packages go into a virtual environment of their own.

Units: spectra are two-sided densities a sample (U², frequency in cycles per sample), averaging factors m in samples.
"""

import argparse
import itertools
import json
import os
import pathlib
import subprocess
import sys
import tempfile
import time
import venv

ROOT = pathlib.Path(__file__).resolve().parent.parent.parent
HOME = ROOT / "target" / "peers" / "sim_to_real"
PYTHON = HOME / "venv" / "bin" / "python"
PACKAGES = ["numpy==2.4.6", "scipy==1.17.1", "pandas==3.1.1"]
if pathlib.Path(sys.prefix) == HOME / "venv":
    import numpy as np
    import pandas
    from scipy import fft, ndimage, optimize, stats

N = 65_536
SUITE = {"seed": 2026, "cases": 1000}
CLASSES = ["none", "known", "single", "pair", "several", "superfluous", "size", "outside", "kept"]
METHODS = ["whiteness", "gmwm", "c2st", "allan"]
# False alarms a record that each method may make of its model.
ALPHA = 0.02
# An effect counts from here on (docs/trial.md).
ABOVE = 1.5
# Simulations of the declared model that a recording is held against.
SIMS, SIMS_STATED = 2, 4
# Each third model without effects makes a record without a gap.
NULL_EVERY = 3
FACTORS = [1 << j for j in range(14)]
WINDOW = 256
FOLDS = 5
# Kinds whose documented name is another (crates/imu-trial/src/kind.rs).
NAMES = {kind: "variance_change" for kind in ("variance_interval", "variance_profile", "variance_per_c")}
STAMPED, LIBRARY = {"timing", "wandering_clock"}, ["single", "pair", "several", "superfluous", "size"]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=SUITE["cases"], help="how many, from the first")
    parser.add_argument("--seed", type=int, default=SUITE["seed"], help="other cases of the same kind, for development")
    parser.add_argument("--ours", type=pathlib.Path, help="folder of `vn100d trial --suite 2026 --out`")
    parser.add_argument("--only", default="", help="classes or kinds, with --seed: as `vn100d trial --kinds`")
    parser.add_argument("--binary", type=pathlib.Path, default=ROOT / "target" / "release" / "vn100d")
    parser.add_argument("--fresh", action="store_true", help="forget the answers that are kept")
    options = parser.parse_args()
    if not options.binary.exists():
        sys.exit(f"{options.binary} is missing: run `cargo build --release` first, or name it with --binary")
    if pathlib.Path(sys.prefix) != HOME / "venv":
        if not PYTHON.exists():
            venv.create(HOME / "venv", with_pip=True)
        if subprocess.run([PYTHON, "-c", "import scipy, pandas"], stderr=subprocess.DEVNULL).returncode != 0:
            subprocess.run([PYTHON, "-m", "pip", "install", "--quiet", *PACKAGES], check=True)
        one = {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")}
        sys.exit(subprocess.run([PYTHON, __file__, *sys.argv[1:]], env={**os.environ, **one}).returncode)
    compare(options)


def part(options, what, *words):
    """Output of `vn100d trial-part`, bytes; the arguments are those of docs/trial.md."""
    shape = ["--seed", str(options.seed), "--cases", str(SUITE["cases"]), "--samples", str(N)]
    shape += ["--kinds", options.only or ",".join(CLASSES)]
    command = [options.binary, "trial-part", what, *shape, *words]
    return subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout


class Record:
    """y: channels × N, U, without lost samples; temperature: N, °C, or none; model: the JSON; names: channels."""

    def __init__(self, rate_hz, names, y, temperature, model):
        self.rate_hz, self.names, self.y, self.temperature, self.model = rate_hz, names, y, temperature, model

    @classmethod
    def unpacked(cls, parcel):
        """Of a parcel (crates/imu-trial/src/parcel.rs). Lost samples are the median of 16 neighbours and white noise."""
        line, body = parcel.split(b"\n", 1)
        head = json.loads(line)
        columns = len(head["channels"]) + head["temperature"]
        values = np.frombuffer(body, "<f8")[: columns * head["samples"]].reshape(columns, -1).copy()
        random = np.random.RandomState(1)
        for row in values:
            lost = ~np.isfinite(row)
            lost[head["missing"]] = True
            row[lost] = np.nan
            step = np.nanmedian(np.abs(np.diff(row))) / 0.954
            for at in np.flatnonzero(lost):
                near = row[max(0, at - 8) : at + 9]
                level = np.nanmedian(near if np.isfinite(near).any() else row)
                row[at] = level + step * random.normal()
        # Readings in steps of 0.1 °C: their mean over a minute.
        rest = ndimage.uniform_filter1d(values[-1], int(60 * head["rate_hz"])) if head["temperature"] else None
        return cls(head["rate_hz"], head["channels"], values[: len(head["channels"])], rest, head["model"])


def simulated(options, record, laws, seed):
    """A record that `vn100d simulate` makes of the model with the laws' N, B, K and levels, at its temperature."""
    channels = {}
    for name, law in zip(record.names, laws):
        n, b, k = np.sqrt(law.theta * [1 / record.rate_hz, 1, record.rate_hz])
        effects = [e for e in record.model["channels"][name].get("effects", []) if e["effect"] != "timing"]
        channels[name] = {"N": n, "B": b, "K": k, "bias": law.level, "effects": effects}
    with tempfile.TemporaryDirectory(dir=HOME) as folder:
        folder = pathlib.Path(folder)
        (folder / "model.json").write_text(json.dumps(record.model | {"channels": channels}))
        words = ["--model", folder / "model.json", "--duration", f"{N / record.rate_hz:.6f}s", "--seed", str(seed)]
        if record.temperature is not None:
            t = np.arange(0, N, 64) / record.rate_hz
            course = pandas.DataFrame({"time_s": t, "temperature_c": record.temperature[::64]})
            course.to_csv(folder / "warm.csv", index=False)
            words += ["--temperature", folder / "warm.csv"]
        command = [options.binary, "simulate", *words, "--out", folder / "sim.csv"]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        frame = pandas.read_csv(folder / "sim.csv")
    y = [frame[next(c for c in frame if c.startswith(name + "_"))].to_numpy()[:N] for name in record.names]
    return Record(record.rate_hz, record.names, np.array(y), record.temperature, record.model)


def tools():
    """Grid (the N−1 frequencies k/2N of the DCT-II), spectra of N, B, K (3 × N−1), bins, Haar gains (14 × N−1), further
    terms."""
    global GRID, BASE, STARTS, COUNTS, HAAR, SINES, TIMES, EXTRA
    GRID = np.arange(1, N) / (2 * N)
    BASE = np.array([np.ones(N - 1), 1 / (2 * np.pi * GRID), 1 / (4 * np.sin(np.pi * GRID) ** 2)])
    edges = [*range(128)]
    while edges[-1] < N - 1:
        edges.append(edges[-1] + int(np.clip(edges[-1] * 0.06, 1, N / 320)))
    STARTS = np.array(edges[:-1])
    COUNTS = np.diff([*STARTS, N - 1])
    # Haar wavelet variance at level j is half the Allan variance at m = 2^j samples (Percival and Guttorp 1994).
    HAAR = np.array([np.sin(np.pi * GRID * m) ** 4 / (m * np.sin(np.pi * GRID)) ** 2 for m in FACTORS]) / N
    SINES, TIMES = np.geomspace(3 / N, 0.49, 72), np.geomspace(2, 8192, 20)
    EXTRA = {"quantization_noise": [4 * np.sin(np.pi * GRID) ** 2], "gauss_markov": [markov(tc) for tc in TIMES]}


def markov(tc, centre=0.0):
    """AR(1) of variance 1 and time constant tc, samples, about a frequency, cycles per sample."""
    phi = np.exp(-1 / tc)
    return (1 - phi**2) / (1 + phi**2 - 2 * phi * np.cos(2 * np.pi * (GRID - centre)))


def sine_variance(f):
    """Wavelet variances (14) of a sine of amplitude 1 at f, cycles per sample."""
    m = np.array(FACTORS)
    return 0.5 * np.sin(np.pi * f * m) ** 4 / (m * np.sin(np.pi * f)) ** 2


def binned(values):
    return np.add.reduceat(values, STARTS, axis=-1) / COUNTS


class Declared:
    """What the model states of a channel beside N, B and K: course (N, U), lines [(cycles per sample, amplitude)],
    spectra by name, the filters' gain and the density behind them, the white part's factor and the bursts' variance
    (N each). Forms: docs/effects.md."""

    def __init__(self, record, name):
        rate = record.rate_hz
        t = np.arange(N) / rate
        self.course, self.lines, self.spectra, self.courses = np.zeros(N), [], {}, {}
        self.gain, self.behind = np.ones(N - 1), 0.0
        self.factor, self.bursts = np.ones(N), np.zeros(N)
        self.effects = [e["effect"] for e in record.model["channels"][name].get("effects", [])]
        for e in record.model["channels"][name].get("effects", []):
            kind, course, spectrum = e["effect"], None, None
            if kind == "rate_ramp":
                course = e["R"] * t
            elif kind == "warm_up":
                course = e["amplitude"] * np.exp(-t / e["tau_s"])
            elif kind == "bias_step":
                course = e["size"] * (t >= e["at_s"])
            elif kind == "temperature_bias" and record.temperature is not None:
                course = e["per_c"] * (record.temperature - e["reference_c"])
            elif kind == "tone":
                self.lines.append((e["frequency_hz"] / rate, e["amplitude"]))
            elif kind == "comb":
                self.lines += [(i * e["fundamental_hz"] / rate, a) for i, a in enumerate(e["amplitudes"], 1)]
            elif kind == "gauss_markov":
                spectrum = e["sigma"] ** 2 * markov(e["tc_s"] * rate)
            elif kind == "quantization_noise":
                spectrum = (e["Q"] * rate) ** 2 * EXTRA["quantization_noise"][0]
            elif kind == "resonance":
                tc, centre = rate / (np.pi * e["bandwidth_hz"]), e["frequency_hz"] / rate
                spectrum = e["sigma"] ** 2 * (markov(tc, centre) + markov(tc, -centre)) / 2
            elif kind in ("low_pass", "moving_average"):
                if kind == "low_pass":
                    ratio = np.tan(np.pi * GRID) / np.tan(np.pi * e["cutoff_hz"] / rate)
                    self.gain = self.gain / (1 + ratio ** (2 * e["order"]))
                else:
                    ratio = np.sin(np.pi * GRID * e["window"]) / (e["window"] * np.sin(np.pi * GRID))
                    self.gain = self.gain * ratio**2
                self.behind += e.get("white_behind", 0.0) ** 2 * rate
            elif kind == "resolution":
                self.behind += e["step"] ** 2 / 12
            elif kind == "bursts":
                for a, b in e["intervals"]:
                    self.bursts[(t >= a) & (t < b)] = e["sigma"] ** 2
                spectrum = np.full(N - 1, self.bursts.mean())
            elif kind == "common_mode":
                spectrum = np.full(N - 1, e["sigma"] ** 2)
            elif kind == "held_samples":
                p = e["probability"]
                self.gain = self.gain * (1 - p**2) / (1 + p**2 - 2 * p * np.cos(2 * np.pi * GRID))
            elif kind == "variance_change":
                self.factor = self.factor * factor(e, t, record.temperature)
            if course is not None:
                self.course = self.course + course
                self.courses[kind] = self.courses.get(kind, 0) + course
            if spectrum is not None:
                self.spectra[kind] = self.spectra.get(kind, 0) + spectrum


def factor(e, t, temperature):
    if "profile" in e:
        return np.interp(t, *np.transpose(e["profile"]))
    if "per_c" in e:
        return np.ones(N) if temperature is None else np.exp(e["per_c"] * (temperature - e.get("reference_c", 25.0)))
    return np.where((t >= e["from_s"]) & (t < e["to_s"]), e["factor"], 1.0)


class Law:
    """theta = (N²·rate, B², K²/rate), refitted by Whittle's likelihood in the DCT-II, what is declared held fixed;
    level: U, beside the declared courses; plain: N, U, without level, courses and lines; rest: the same without spikes;
    residual: N, whitened; spectrum: N−1."""

    def __init__(self, y, declared, start):
        self.y, rest = y, y - declared.course
        self.level = float(np.mean(rest))
        rest = rest - self.level
        for f, amplitude in declared.lines:
            # The declared line at the phase that fits: the model knows its amplitude, not its phase.
            wave = np.exp(-2j * np.pi * f * np.arange(N))
            phase = rest @ wave
            rest = rest - amplitude * np.real(wave * np.conj(phase)) / abs(phase)
        self.plain = self.rest = rest
        c = fft.dct(rest, norm="ortho")[1:]
        if "spikes" in declared.effects:
            # A few large ones say nothing of N: what is beyond six deviations of its neighbours is left out.
            middle = ndimage.median_filter(rest, 9)
            far = np.abs(rest - middle)
            self.rest = np.where(far > 6 * 1.483 * np.median(far), middle, rest)
        clean = fft.dct(self.rest, norm="ortho")[1:]
        white = BASE * np.array([np.mean(declared.factor**2), 1, 1])[:, None] * declared.gain
        fixed = sum(declared.spectra.values(), np.zeros(N - 1)) * declared.gain + declared.behind
        power, a, a0 = binned(clean**2), binned(white), binned(fixed)
        unit = max(np.median(power[-200:]), 1e-300)
        power, a0 = power / unit, a0 / unit
        # N is never off by more than 3 (docs/trial.md).
        within = np.array([start[0] / 16, start[0] * 16]) / unit
        best = np.inf
        for theta in (start / unit, np.array([1.0, 0.003, 1e-7]), np.array([1.0, 0.03, 1e-9])):
            for _ in range(12):
                s = a0 + theta @ a + 1e-12
                w = np.sqrt(COUNTS / 2) / s
                scale = np.linalg.norm(a * w, axis=1)
                theta = optimize.nnls((a * w / scale[:, None]).T, (power - a0) * w)[0] / scale
                theta[0] = np.clip(theta[0], *within)
            s = a0 + theta @ a + 1e-12
            cost = np.sum(COUNTS * (np.log(s) + power / s))
            if cost < best:
                best, self.theta = cost, theta * unit
        self.declared, self.basis, self.fixed, self.start = declared, white, fixed, max(float(start[0]), 1e-300)
        self.spectrum = np.maximum(fixed + self.theta @ white, 0.01 * unit)
        self.residual = fft.idct(np.concatenate([[0.0], c / np.sqrt(self.spectrum)]), norm="ortho")
        # Where the model knows that the white part is louder, the residual is divided by how much.
        loud = self.theta[0] * declared.factor**2 + declared.bursts
        loud = loud + self.theta[1] / 1.6 + declared.behind + 1e-4 * unit
        self.residual /= np.sqrt(loud / loud.mean())
        # By how much that makes variances scatter more.
        self.uneven = np.mean(loud**2) / loud.mean() ** 2


def laws_of(record):
    rate, made = record.rate_hz, []
    for name, y in zip(record.names, record.y):
        start = np.array([record.model["channels"][name].get(p, 0.0) ** 2 for p in "NBK"]) * [rate, 1, 1 / rate]
        made.append(Law(y, Declared(record, name), start))
    return made


def moments(residual):
    """Autocorrelations of residual and squares (2 × 500), skewness and kurtosis in standard errors, course (64)."""
    squares = np.minimum(residual**2, 16.0)
    both = np.array([residual - residual.mean(), squares - squares.mean()])
    covariances = fft.irfft(np.abs(fft.rfft(both, 2 * N)) ** 2)[:, :501]
    shape = np.array([stats.skew(residual), stats.kurtosis(residual)]) / np.sqrt([6 / N, 24 / N])
    course = squares.reshape(64, -1).mean(axis=1) / np.sqrt(squares.var() * 64 / N)
    return {"lags": covariances[:, 1:] / covariances[:, :1], "shape": shape, "course": course}


def whiteness(real, sims, stated):
    """−ln of the least of six p-values. Each statistic is of the difference to the simulations' mean. If the
    model states effects (few spikes, say), that is held against how much the simulations differ from one another."""

    def six(one, others):
        spread = 1 + 1 / len(others)
        of = {key: one[key] - np.mean([other[key] for other in others], axis=0) for key in one}
        lags = N * of["lags"] ** 2 / spread
        sums = [lags[0, :20].sum(), lags[0].sum(), lags[1, :20].sum(), lags[1].sum()]
        return np.array([*sums, np.sum(of["shape"] ** 2) / spread, np.sum(of["course"] ** 2) / spread])

    freedom = np.array([20, 500, 20, 500, 2, 64])
    own = np.mean([six(sim, [other for other in sims if other is not sim]) for sim in sims], axis=0)
    found = six(real, sims)
    p = stats.f.logsf(found / np.maximum(own, freedom), 4, 6) if stated else stats.chi2.logsf(found, freedom)
    return {"score": float(min(700.0, -np.min(p)))}


def wavelet_variance(y):
    """Haar MODWT variances (14), U², of the samples themselves."""
    x = np.concatenate([[0.0], np.cumsum(y - y.mean())])
    return np.array([np.mean((x[2 * m :] - 2 * x[m:-m] + x[: -2 * m]) ** 2) / (4.0 * m * m) for m in FACTORS])


def variance_cov(spectrum):
    """Covariance (14 × 14) of the variances of Gaussian noise with this spectrum."""
    left = N + 1 - 2 * np.array(FACTORS)
    gains = HAAR * N * spectrum
    return 2 * (gains @ gains.T) / N / np.sqrt(np.outer(left, left))


def gmwm(y, law):
    """Candidates: the declared model and up to two further terms, with what is declared held fixed or one of it free.
    gain: chi-square that the best candidate gains over the declared model, less 2 for each parameter (as WIC and AIC
    charge); misfit: chi-square of the best; named: (effect, sense) of its terms, the most costly to leave out first."""
    declared, nu = law.declared, wavelet_variance(law.rest)
    gained = lambda spectra: (HAAR @ (np.array(spectra) * declared.gain).T).T
    base = HAAR @ law.basis.T
    own = {name: HAAR @ (spectrum * declared.gain) for name, spectrum in declared.spectra.items()}
    whole = HAAR.sum(axis=1) * declared.behind + sum(own.values())
    # What the model knows of a course or a line is taken off the samples; where it is free it is left in.
    left = {name: nu for name in own}
    for name, course in declared.courses.items():
        own[name], left[name] = wavelet_variance(course), wavelet_variance(y - declared.course + course)
    if declared.lines:
        name = "comb" if "comb" in declared.effects else "tone"
        own[name] = sum(a**2 * sine_variance(f) for f, a in declared.lines)
        left[name] = wavelet_variance(y - declared.course)
    further = {
        "quantization_noise": gained(EXTRA["quantization_noise"]),
        "rate_ramp": [np.array(FACTORS, float) ** 2 / 4],
        "gauss_markov": gained(EXTRA["gauss_markov"]),
        "tone": [sine_variance(f) for f in SINES],
    }
    parameters = {"quantization_noise": 1, "rate_ramp": 1, "gauss_markov": 2, "tone": 2}
    free = [name for name in own if name not in ("bursts", "common_mode")]
    # The covariance is that of the declared model, as it is where there is no gap.
    root = np.linalg.inv(np.linalg.cholesky(law.uneven * variance_cov(law.spectrum)))

    def fitted(columns, rest):
        a = root @ np.array([*base.T, *columns]).T
        scale = np.linalg.norm(a, axis=0)
        theta, distance = optimize.nnls(a / scale, root @ rest, maxiter=200)
        return distance**2, theta / scale

    tried = {}
    for loose in [None, *free]:
        rest = nu - whole if loose is None else left[loose] - whole + own[loose] * (loose in declared.spectra)
        before = [] if loose is None else [own[loose]]
        # Pairs are made of the best of each kind.
        best = {}
        for kind, grid in further.items():
            best[kind] = grid[int(np.argmin([fitted([*before, column], rest)[0] for column in grid]))]
        for kinds in [(), *itertools.combinations(further, 1), *itertools.combinations(further, 2)]:
            distance, theta = fitted([*before, *(best[kind] for kind in kinds)], rest)
            price = 2 * bool(loose) + 2 * sum(parameters[kind] for kind in kinds)
            tried[loose, kinds] = (distance + price, distance, theta)
    loose, kinds = min(tried, key=lambda name: tried[name][0])
    cost, misfit, theta = tried[loose, kinds]
    without = {kind: tried[loose, tuple(other for other in kinds if other != kind)][0] for kind in kinds}
    named = {(kind, "size" if kind in own else "missing"): without[kind] for kind in kinds}
    if loose:
        named[loose, "superfluous" if theta[3] < 0.2 else "size"] = tried[None, kinds][0]
    return {"gain": tried[None, ()][0] - cost, "misfit": misfit, "named": sorted(named, key=lambda name: -named[name])}


def features(laws, white):
    """Windows × features for each channel, of 256 windows of 256 samples. white: each channel's standard deviation."""
    length, made = N // WINDOW, []
    # Declared lines have a phase that nobody knows: they are taken off.
    samples = np.array([law.plain if law.declared.lines else law.y for law in laws])
    differences = np.diff(samples, axis=1, append=samples[:, -1:]).reshape(len(laws), length, WINDOW)
    differences = differences - differences.mean(axis=2, keepdims=True)
    norm = np.linalg.norm(differences, axis=2) + 1e-300
    taper = np.hanning(WINDOW)
    for own, (y, s) in enumerate(zip(samples, white)):
        x = (y / s).reshape(length, WINDOW)
        mean = x.mean(axis=1)
        steps = np.pad(mean, 1, mode="edge")
        line = np.arange(WINDOW) - (WINDOW - 1) / 2
        slope = (x - mean[:, None]) @ line / (line @ line)
        rest = x - mean[:, None] - slope[:, None] * line
        deviation = rest.std(axis=1) + 1e-12
        unit = rest / deviation[:, None]
        power = np.abs(np.fft.rfft(rest * taper, axis=1))[:, 1:] ** 2 + 1e-12
        bands = [np.log(power[:, 2**i - 1 : 2 ** (i + 1) - 1].mean(axis=1)) for i in range(7)]
        ordered = np.sort(x, axis=1)
        columns = [mean - (steps[:-2] + steps[2:]) / 2, np.log(deviation), slope * WINDOW, *bands]
        columns += [(unit**3).mean(axis=1), np.log((unit**4).mean(axis=1)), np.abs(unit).max(axis=1)]
        columns += [np.log(power.max(axis=1) / power.mean(axis=1)), (np.diff(ordered, axis=1) > 0).mean(axis=1)]
        columns += [(np.diff(x, axis=1) == 0).mean(axis=1), (unit[:, 1:] * unit[:, :-1]).mean(axis=1)]
        for other in range(len(laws)):
            if other != own:
                columns.append(np.sum(differences[own] * differences[other], axis=1) / norm[own] / norm[other])
        made.append(np.transpose(columns))
    return made


def c2st(real, sims):
    """Deviation of the balanced accuracy from 1/2, in standard errors. real: windows × features, sims: list of such.
    Folds are stretches of time: neighbours do not stand on both sides. Ridge logistic regression on features and
    their squares."""
    x = np.concatenate([real, *sims])
    label = np.repeat([1.0, 0.0], [len(real), len(real) * len(sims)])
    fold = np.tile(np.arange(len(real)) * FOLDS // len(real), 1 + len(sims))
    right = np.zeros(len(label))
    for held in range(FOLDS):
        train = fold != held
        centre, scale = np.median(x[train], axis=0), x[train].std(axis=0) + 1e-9
        z = np.clip((x - centre) / scale, -6, 6)
        z = np.column_stack([np.ones(len(z)), z, z**2 - 1])
        weight = np.where(label == 1, len(sims), 1.0)[train]
        beta = np.zeros(z.shape[1])
        ridge = np.eye(len(beta)) * 10.0
        ridge[0, 0] = 1e-6
        for _ in range(6):
            p = 1 / (1 + np.exp(-np.clip(z[train] @ beta, -30, 30)))
            gradient = z[train].T @ (weight * (label[train] - p)) - ridge @ beta
            curved = weight * p * (1 - p) + 1e-9
            beta = beta + np.linalg.solve((z[train].T * curved) @ z[train] + ridge, gradient)
        right[~train] = ((z[~train] @ beta > 0) == (label[~train] == 1)).astype(float)
    accuracy = (right[label == 1].mean() + right[label == 0].mean()) / 2
    return {"score": float((accuracy - 0.5) / np.sqrt(0.25 / len(real) * (1 + 1 / len(sims)) / 2))}


def allan(law):
    """z: how far ln of the recording's Allan variances is from the model's, in standard errors (14). N, B and K are
    fitted to the curve itself, with less weight for what stands out: a reader lays lines along its straight parts."""
    declared = law.declared
    nu = 2 * wavelet_variance(law.rest)
    base, fixed = 2 * (HAAR @ law.basis.T), 2 * (HAAR @ law.fixed)
    spread = 2 * np.sqrt(law.uneven * np.diag(variance_cov(law.spectrum)))
    spread = spread / np.maximum(base @ law.theta + fixed, 1e-300)
    theta = law.theta
    for _ in range(12):
        model = np.maximum(base @ theta + fixed, 1e-12 * abs(nu).max())
        z = (nu - model) / model / spread
        weight = np.sqrt(np.minimum(1.0, 2.0 / np.maximum(np.abs(z), 1e-9))) / model / spread
        a = base * weight[:, None]
        scale = np.linalg.norm(a, axis=0) + 1e-300
        theta = optimize.nnls(a / scale, (nu - fixed) * weight)[0] / scale
    model = np.maximum(base @ theta + fixed, 1e-12 * abs(nu).max())
    z = np.log(np.maximum(nu, 1e-3 * model) / model) / spread
    level = np.log(np.maximum(nu, 1e-3 * model) * FACTORS / law.start)
    curve = {"z": z.tolist(), "excess": (nu - model).tolist(), "level": level.tolist()}
    return {"score": float(np.abs(z).max()), "curve": curve, "declared": declared.effects}


def read_off(curve, declared, band):
    """[effect, sense] that the rules name, or none. z and excess over the fitted model at m = 1 … 8192; level: ln of m
    times the variance over the declared white part. A slope of −2 of the variance is −1 of the deviation."""
    z, excess, level = (np.array(curve[key]) for key in ("z", "excess", "level"))
    top = int(np.argmax(np.abs(z)))
    sign = np.sign(z[top])
    first = last = top
    while first > 0 and sign * z[first - 1] > band / 2:
        first -= 1
    while last < 13 and sign * z[last + 1] > band / 2:
        last += 1
    filters = [name for name in declared if name in ("low_pass", "moving_average")]
    added = [name for name in declared if name not in filters and name != "timing"]
    bend = int(np.argmax(level[:5]))
    if level[bend] - level[0] > 0.15 and abs(level[bend]) < abs(level[0]):
        # It bends down at short times, and what is declared is met behind the bend.
        return [filters[0], "size"] if filters else ["low_pass", "missing"]
    if sign < 0 and added:
        return [added[0], "superfluous"]
    if sign < 0:
        # Levels off where a walk would rise on.
        return ["gauss_markov", "missing"] if last >= 12 else None
    if filters and first == 0:
        return [filters[0], "superfluous"]
    m, size = np.log(FACTORS[first : last + 1]), np.log(np.maximum(excess[first : last + 1], 1e-300))
    peak = int(np.argmax(size))
    slope = lambda x, y: np.polyfit(x, y, 1)[0] if len(x) > 1 else 0.0
    rises, falls = slope(m[: peak + 1], size[: peak + 1]), slope(m[peak:], size[peak:])
    if first == 0 and peak == 0 and falls < -1.5 and np.ptp((size + 2 * m)[:3]) < 0.7:
        name = "quantization_noise"
    elif last >= 12 and peak >= len(m) - 2:
        if rises < 1.5:
            return None
        name = "rate_ramp"
    else:
        name = "tone" if falls < -1.5 or rises > 1.5 or len(m) == 1 else "gauss_markov"
    return [name, "size" if name in declared else "missing"]


def answers(options, record, seed):
    """Scores by method, a list with an entry for each channel."""
    laws = laws_of(record)
    white = [np.sqrt(np.mean(law.spectrum)) for law in laws]
    stated = [any(name != "timing" for name in law.declared.effects) for law in laws]
    sims = [simulated(options, record, laws, 10_000 * seed + i) for i in range(SIMS_STATED if any(stated) else SIMS)]
    laws_of_sims = [laws_of(sim) for sim in sims]
    of_sims = [[moments(law.residual) for law in own] for own in laws_of_sims]
    windows, *of_windows = [features(own, white) for own in (laws, *laws_of_sims)]
    found = {method: [] for method in METHODS}
    for at, law in enumerate(laws):
        found["whiteness"].append(whiteness(moments(law.residual), [sim[at] for sim in of_sims], stated[at]))
        found["gmwm"].append(gmwm(record.y[at], law))
        found["c2st"].append(c2st(windows[at], [sim[at] for sim in of_windows]))
        found["allan"].append(allan(law))
    return laws, {"channels": record.names, "stated": stated, "found": found}


def compare(options):
    tools()
    HOME.mkdir(parents=True, exist_ok=True)
    kept = HOME / f"answers-{options.seed}{'-' + options.only if options.only else ''}.jsonl"
    if options.fresh:
        kept.unlink(missing_ok=True)
    known = {}
    if kept.exists():
        known = {row["case"]: row for row in map(json.loads, kept.read_text().splitlines())}
    begun, made = time.perf_counter(), 0
    with kept.open("a") as out:
        for case in range(options.cases):
            if case in known:
                continue
            record = Record.unpacked(part(options, "case", "--case", str(case)))
            laws, row = answers(options, record, 2 * case + 1)
            row["case"] = case
            if any(row["stated"]) or case % NULL_EVERY == 0:
                null = simulated(options, record, laws, 10_000 * (2 * case + 2) + 9)
                row["null"] = answers(options, null, 2 * case + 2)[1]["found"]
            known[case] = json.loads(json.dumps(row))
            out.write(json.dumps(row) + "\n")
            out.flush()
            made += 1
            if made % 25 == 0:
                print(f"{made} cases, {(time.perf_counter() - begun) / made:.2f} s each", file=sys.stderr)
    rows = [known[case] for case in range(options.cases)]
    keys = json.loads(part(options, "key"))
    report(options, rows, keys)


SCORES = [("whiteness", "score"), ("gmwm", "gain"), ("gmwm", "misfit"), ("c2st", "score"), ("allan", "score")]


def thresholds(rows):
    """By number of channels, whether the model states effects there, method and score: what one of so many channels
    passes by chance in ALPHA of the records (half of it where a method has two scores), a quantile of the channels of
    the records without a gap."""
    made = {}
    for method, score in SCORES:
        null = {True: [], False: []}
        for row in rows:
            for stated, one in zip(row["stated"], row["null"][method] if "null" in row else []):
                null[stated].append(one[score])
        level = ALPHA / 2 if method == "gmwm" else ALPHA
        for channels in (2, 6):
            for stated, of in null.items():
                made[channels, stated, method, score] = np.quantile(of, (1 - level) ** (1 / channels)) if of else np.inf
    return made


def said(row, bands):
    """By method: channels that are blamed and [effect, sense, channels] in order, the first channel's first."""
    answer_of = {}
    for method, entries in row["found"].items():
        named, blamed = {}, []
        strength = {"gmwm": "gain"}.get(method, "score")
        clear = lambda at: -entries[at][strength] / bands[len(entries), row["stated"][at], method, strength]
        for at in sorted(range(len(entries)), key=clear):
            one, channel = entries[at], row["channels"][at]
            of = {name for name in ("score", "gain", "misfit") if name in one}
            band = {name: bands[len(entries), row["stated"][at], method, name] for name in of}
            if all(one[name] <= band[name] for name in band):
                continue
            blamed.append(channel)
            names = []
            if method == "gmwm" and one["gain"] > band["gain"]:
                names = one["named"]
            elif method == "allan":
                names = [read_off(one["curve"], one["declared"], band["score"])]
            for name in filter(None, names):
                named.setdefault(tuple(name), []).append(channel)
        names = [[*name, on] for name, on in named.items()]
        answer_of[method] = {"gap": bool(blamed), "blamed": blamed, "named": names}
    return answer_of


def ours(folder, rows, keys):
    """The same of the diagnoses in a trial's folder: reports/NUMBER.json, judgements.json. A gap is an effect that is
    named, or a remainder; wrong N, B and K are none. As in the trial, a `timing` of the delivery is set aside."""
    judged = folder / "judgements.json"
    first = {}
    if judged.exists():
        judgements = json.loads(judged.read_text())
        first = {one["case"]: bool(one["causes"]) and one["causes"][0]["right"] for one in judgements}
    found = {}
    for row in rows:
        case = row["case"]
        path = folder / "reports" / f"{case:05}.json"
        if not path.exists():
            if judged.exists() and case in first:
                found[case] = {"gap": False, "blamed": [], "named": [], "right": False}
            continue
        document, stamps = json.loads(path.read_text()), keys[case]["stamps"] or {"late_s": 0, "lost": 0}
        late = max(stamps["late_s"], stamps["lost"]) > 0 and not STAMPED & {e["kind"] for e in keys[case]["effects"]}
        causes = [cause for cause in document["causes"] if not (late and cause["effect"] == "timing")]
        rest = document.get("remainder")
        gap = bool(causes) or rest is not None or document["verdict"] == "unknown_effect"
        blamed = {channel for cause in causes for channel in cause["channels"]} | set(rest["channels"] if rest else [])
        named = [[cause["effect"], cause.get("sense", "missing"), cause["channels"]] for cause in causes]
        found[case] = {"gap": gap, "blamed": sorted(blamed), "named": named}
        if case in first:
            found[case]["right"] = first[case]
    return found


def right_first(answer, key):
    """Whether the first effect that is named is one of the case's (docs/trial.md): name, a channel, and sense."""
    if "right" in answer:
        return answer["right"]
    if not answer["named"]:
        return False
    effect, sense, on = answer["named"][0]
    return any(
        NAMES.get(truth["kind"], truth["kind"]) == effect
        and (truth["kind"] == "timing" or set(on) & set(truth["channels"]))
        and truth["sense"] in (sense, "elsewhere")
        for truth in key["effects"]
    )


def rate(hits):
    """Count and Clopper and Pearson's 95 % interval."""
    hits = list(hits)
    k, n = sum(hits), len(hits)
    if n == 0:
        return "–"
    low, high = stats.beta.ppf(0.025, k, n - k + 1) if k else 0, stats.beta.ppf(0.975, k + 1, n - k) if k < n else 1
    return f"{k}/{n} = {100 * k / n:.0f} % ({100 * low:.0f}–{100 * high:.0f})"


def table(head, lines):
    print("\n| " + " | ".join(head) + " |\n|" + "---|" * len(head))
    for line in lines:
        print("| " + " | ".join(line) + " |")


def report(options, rows, keys):
    bands = thresholds(rows)
    answer_of = {row["case"]: said(row, bands) for row in rows}
    methods = list(METHODS)
    if options.ours:
        found = ours(options.ours, rows, keys)
        rows = [row for row in rows if row["case"] in found]
        for case, answer in found.items():
            answer_of[case]["vn100d"] = answer
        methods.append("vn100d")
    nulls = [said(row | {"found": row["null"]}, bands) for row in rows if "null" in row]
    print(f"First {len(rows)} cases of seed {options.seed}, {len(nulls)} records without a gap, {ALPHA:.0%} a record.")
    if options.ours and not (options.ours / "judgements.json").exists():
        print("Names of vn100d count by name, channel and sense alone: the trial is not over and has judged none.")
    of = {name: [] for name in CLASSES}
    for case in (row["case"] for row in rows):
        key = keys[case]
        if key["class"] not in LIBRARY or all(effect["over_limit"] >= ABOVE for effect in key["effects"]):
            of[key["class"]].append(case)
    print("\n**Reports a gap**")
    lines = [["no gap, simulated", *(rate(one[m]["gap"] for one in nulls) if m in METHODS else "–" for m in methods)]]
    lines += [[f"`{name}`", *(rate(answer_of[c][m]["gap"] for c in of[name]) for m in methods)] for name in CLASSES]
    table(["class", *methods], lines)
    print("\n**Channels, of the cases in which it reports a gap**")
    stamped = lambda c: {effect["kind"] for effect in keys[c]["effects"]} <= STAMPED
    true = lambda c: {channel for effect in keys[c]["effects"] for channel in effect["channels"]}
    lines = []
    for title, names in (("library", LIBRARY), ("outside the library", ["outside", "kept"])):
        for what, holds in (("a right one", set.__and__), ("all of them, no other", set.__eq__)):
            line = [f"{title}: {what}"]
            for m in methods:
                cases = [c for name in names for c in of[name] if answer_of[c][m]["gap"] and not stamped(c)]
                line.append(rate(bool(holds(set(answer_of[c][m]["blamed"]), true(c))) for c in cases))
            lines.append(line)
    table(["", *methods], lines)
    naming = [m for m in methods if m not in ("whiteness", "c2st")]
    cases = [row["case"] for row in rows]
    first = {m: {case: right_first(answer_of[case][m], keys[case]) for case in cases} for m in naming}
    print("\n**Names an effect of the case first, on one of its channels, in its sense**")
    lines = [[f"`{name}`", *(rate(first[m][c] for c in of[name]) for m in naming)] for name in LIBRARY]
    table(["class", *naming], lines)
    print("\n**Single effects by kind**")
    by_kind = {}
    for c in of["single"]:
        by_kind.setdefault(keys[c]["effects"][0]["kind"], []).append(c)
    lines = []
    for kind, cases in sorted(by_kind.items()):
        gaps = [str(sum(answer_of[c][m]["gap"] for c in cases)) for m in methods]
        lines.append([f"`{kind}`", str(len(cases)), *gaps, *(str(sum(first[m][c] for c in cases)) for m in naming)])
    table(["kind", "cases", *(f"gap: {m}" for m in methods), *(f"named: {m}" for m in naming)], lines)


if __name__ == "__main__":
    main()
