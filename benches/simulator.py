"""What `benches/simulator.rs` does, as numpy is usually made to do it: white noise, flicker shaped by FFT over the whole
record, a cumulative sum; nine channels, one process, the whole record in memory.

    python3 benches/simulator.py [RATE_HZ]
"""

import resource
import sys
import time

import numpy as np

LENGTH_S = 18_000
CHANNELS = 9
N, B, K = 1.2e-4, 2.6e-5, 1.5e-6


def channel(rng, count, rate_hz):
    white = N * np.sqrt(rate_hz) * rng.standard_normal(count)
    spectrum = np.fft.rfft(rng.standard_normal(count))
    frequency = np.fft.rfftfreq(count, 1 / rate_hz)
    frequency[0] = frequency[1]
    # Two-sided density B²/(2πf) of samples at rate_hz.
    flicker = np.fft.irfft(spectrum * B * np.sqrt(rate_hz / (2 * np.pi * frequency)), count)
    walk = K / np.sqrt(rate_hz) * np.cumsum(rng.standard_normal(count))
    return white + flicker + walk


def main():
    rate_hz = float(sys.argv[1]) if len(sys.argv) > 1 else 40.0
    rng = np.random.default_rng(1)
    begun = time.perf_counter()
    for _ in range(CHANNELS):
        channel(rng, int(LENGTH_S * rate_hz), rate_hz)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"numpy {np.__version__}, 5 h at {rate_hz:g} Hz, {CHANNELS} channels: {time.perf_counter() - begun:.3f} s, {peak:.0f} MB")


main()
