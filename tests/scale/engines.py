"""DuckDB, DataFusion and Spark on a data set of captures: reads the folder, computes partial sums, leaves them as CSV.

    python engines.py ENGINE DATA_SET OUT.csv

Each engine runs in a process of its own, so that its memory can be told. Spark runs in local mode on two threads.
"""

import csv
import sys
import time

from partial_sums import Scale, partial_sums, phases

SCALES = {
    "gyro_x": Scale("gyro_x_rad_s", 6, 15),
    "accel_z": Scale("accel_z_m_s2", 3, 23),
}
# Octaves up to half the longest capture.
FACTORS = [2**octave for octave in range(19)]
# What a person asks first: what is there.
CONTENTS = """
SELECT sensor, COUNT(DISTINCT CONCAT(database, CAST(capture AS VARCHAR(20)))) AS captures, COUNT(*) AS samples, AVG(accel_z_m_s2) AS mean_accel_z
FROM samples GROUP BY sensor ORDER BY sensor"""


def duckdb(folder):
    import duckdb

    database = duckdb.connect()
    database.execute(f"CREATE VIEW samples AS SELECT * FROM read_parquet('{folder}/**/*.parquet', hive_partitioning = true)")
    rates = database.execute(
        f"SELECT DISTINCT decode(value) FROM parquet_kv_metadata('{folder}/**/*.parquet') WHERE decode(key) = 'rate_hz'"
    ).fetchall()
    print("rates in the files' metadata:", sorted(row[0] for row in rates))
    return (
        lambda text: database.execute(text).fetchall(),
        lambda name, text: database.execute(f"CREATE OR REPLACE TEMP TABLE {name} AS {text}"),
    )


def datafusion(folder):
    import datafusion
    import pyarrow

    session = datafusion.SessionContext()
    partitions = [("sensor", pyarrow.string()), ("date", pyarrow.string())]
    session.register_parquet("samples", folder, table_partition_cols=partitions)

    def rows(text):
        return [tuple(row.values()) for row in session.sql(text).to_pylist()]

    def keep(name, text):
        kept = session.sql(text).cache()
        if session.table_exist(name):
            session.deregister_table(name)
        session.register_table(name, kept)

    return rows, keep


def spark(folder):
    from pyspark.sql import SparkSession

    session = (
        SparkSession.builder.master("local[2]")
        .config("spark.ui.enabled", "false")
        .config("spark.ui.showConsoleProgress", "false")
        .config("spark.driver.memory", "2g")
        .config("spark.driver.host", "127.0.0.1")
        .config("spark.sql.shuffle.partitions", "8")
        # A serial number is a name, not a number.
        .config("spark.sql.sources.partitionColumnTypeInference.enabled", "false")
        .getOrCreate()
    )
    session.sparkContext.setLogLevel("ERROR")
    # Spark keeps times in microseconds; utc has nanoseconds and is not needed here.
    session.conf.set("spark.sql.legacy.parquet.nanosAsLong", "true")
    session.read.parquet(folder).createOrReplaceTempView("samples")

    def keep(name, text):
        session.catalog.clearCache()
        session.sql(text).cache().createOrReplaceTempView(name)

    return lambda text: [tuple(row) for row in session.sql(text).collect()], keep


def main():
    engine, folder, out = sys.argv[1:]
    begun = time.monotonic()
    rows, keep = {"duckdb": duckdb, "datafusion": datafusion, "spark": spark}[engine](folder)
    for sensor, captures, samples, mean in rows(CONTENTS):
        print(f"sensor {sensor}: {captures} captures, {samples} samples, mean accel_z {mean:.6f} m/s²")
    read_s = time.monotonic() - begun
    with open(out, "w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["channel", "database", "capture", "part", "m", "terms", "largest", "squares"])
        for channel, scale in SCALES.items():
            keep("phases", phases("samples", scale))
            for m in FACTORS:
                for row in rows(partial_sums("phases", m)):
                    table.writerow([channel, *row])
    print(f"{read_s:.1f} s to say what is there, {time.monotonic() - begun:.1f} s in all")


if __name__ == "__main__":
    main()
