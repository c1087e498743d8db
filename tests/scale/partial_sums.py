"""Partial sums of the overlapping Allan variance in SQL, the same text for DuckDB, DataFusion and Spark.

Values become whole steps of the scale that the daemon uses for the channel (crates/imu-noise/src/allan/fixed_point.rs), so
that every sum is exact: sums of parts of a capture, of captures, of days add to the same integer in any order and on any number
of machines. For averaging factor m a part contributes (terms, sum of squares of X[i] - 2 X[i-m] + X[i-2m]) for the i that lie
in it (NIST SP1065, equation 10); phases X run through a capture's segments, so that a part reads what lies before it, as a
window does. Nothing is averaged across a gap: each segment, and each stretch of rows that have the value, stands alone.
"""

# What a capture is known by: ids are those of one database.
CAPTURE = "database, capture"

# Places of a stretch that go into a part: with 40 Hz seven minutes, so that each capture has several.
PART = 16_384

# Second differences up to which a part's sum of squares fits 38 digits: sqrt(10^38 / PART). In an accelerometer's scale a swing
# of 20 m/s² that lasts for 2^18 samples reaches it; at rest none comes near. Beyond it a sum is not to be believed: DuckDB and
# Spark stop there, DataFusion does not.
LARGEST = 7 * 10**16

# Adding and subtracting 1.5 * 2^52 rounds a double below 2^51 to the nearest integer, ties to even, as the daemon does;
# ROUND of the three engines differs for ties.
ROUNDING = "6755399441055744e0"


class Scale:
    """Steps per unit of a channel: 10^decimals * 2^binary, the finest in which decimals are exact and 42 bits suffice."""

    def __init__(self, column, decimals, binary):
        self.column, self.decimals, self.binary = column, decimals, binary

    @property
    def steps_per_unit(self):
        return 10**self.decimals * 2**self.binary


def phases(samples, scale):
    """Of one channel: capture, stretch (segment, and rows without a hole in them), place in it from 1, phase in steps."""
    return f"""
SELECT {CAPTURE}, segment, stretch, i,
       SUM(steps) OVER (PARTITION BY {CAPTURE}, segment, stretch ORDER BY i ROWS UNBOUNDED PRECEDING) AS x
FROM (
  SELECT {CAPTURE}, segment, stretch, steps,
         ROW_NUMBER() OVER (PARTITION BY {CAPTURE}, segment, stretch ORDER BY seq) AS i
  FROM (
    SELECT {CAPTURE}, segment, seq,
           seq - ROW_NUMBER() OVER (PARTITION BY {CAPTURE}, segment ORDER BY seq) AS stretch,
           CAST({scale.column} * {scale.steps_per_unit}e0 + {ROUNDING} - {ROUNDING} AS BIGINT) AS steps
    FROM {samples}
    WHERE {scale.column} IS NOT NULL
  ) AS numbered
) AS placed"""


def partial_sums(phases, m):
    """Terms and sum of squares of each part of each capture, for one averaging factor. The phase before the first is 0."""
    window = f"OVER (PARTITION BY {CAPTURE}, segment, stretch ORDER BY i)"
    return f"""
SELECT {CAPTURE}, part, {m} AS m, COUNT(*) AS terms, MAX(ABS(d)) AS largest,
       SUM(CAST(d AS DECIMAL(19, 0)) * CAST(d AS DECIMAL(19, 0))) AS squares
FROM (
  SELECT {CAPTURE}, segment, i, CAST(FLOOR(i / {PART}e0) AS BIGINT) AS part,
         CAST(x - 2 * LAG(x, {m}, 0) {window} + LAG(x, {2 * m}, 0) {window} AS BIGINT) AS d
  FROM {phases}
) AS differences
WHERE i >= {2 * m}
GROUP BY {CAPTURE}, part"""


def deviation(terms, squares, scale, m):
    """Allan deviation in the channel's unit."""
    return (int(squares) / (2 * m * m * terms)) ** 0.5 / scale.steps_per_unit
