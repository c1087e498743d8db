-- Captures: what was recorded, what is missing, and why.
-- Times: *_utc_ns in ns since 1970-01-01T00:00:00Z, device_time_ns in ns of the sensor's own clock,
-- host_mono_ns in ns of the host's monotonic clock (comparable within one boot). Values as the sensor sent them.

CREATE TABLE capture (
    id                  INTEGER PRIMARY KEY AUTOINCREMENT,  -- never used twice: "latest" is the highest
    name                TEXT    NOT NULL,
    source              TEXT    NOT NULL,                   -- a port, a file, "simulator"
    state               TEXT    NOT NULL
        CHECK (state IN ('waiting', 'capturing', 'complete', 'stopped', 'imported', 'simulated')),
    lifecycle           TEXT    NOT NULL DEFAULT 'live'     -- only live captures are shown
        CHECK (lifecycle IN ('live', 'importing', 'deleted')),
    created_utc_ns      INTEGER NOT NULL,
    start_at_utc_ns     INTEGER,                            -- when a waiting capture shall begin
    planned_duration_ns INTEGER CHECK (planned_duration_ns > 0),
    started_utc_ns      INTEGER,
    ended_utc_ns        INTEGER,
    rate_hz             REAL    CHECK (rate_hz > 0),        -- of the first segment; NULL before it
    rate_assumed        INTEGER NOT NULL DEFAULT 0 CHECK (rate_assumed IN (0, 1)),
    sample_time_ns      INTEGER NOT NULL DEFAULT 0 CHECK (sample_time_ns >= 0),  -- received and missing, at their rates
    samples             INTEGER NOT NULL DEFAULT 0 CHECK (samples >= 0),
    missing             INTEGER NOT NULL DEFAULT 0 CHECK (missing >= 0),
    gaps                INTEGER NOT NULL DEFAULT 0 CHECK (gaps >= 0),
    segments            INTEGER NOT NULL DEFAULT 0 CHECK (segments >= 0),
    pinned              INTEGER NOT NULL DEFAULT 0 CHECK (pinned IN (0, 1)),
    sensor              TEXT    CHECK (sensor IS NULL OR json_valid(sensor)),
    configuration       TEXT    CHECK (configuration IS NULL OR json_valid(configuration)),
    software            TEXT    NOT NULL,                   -- that made it
    fingerprint         TEXT                                -- of an imported recording: the same file once
) STRICT;
CREATE UNIQUE INDEX capture_name ON capture (name) WHERE lifecycle = 'live';
CREATE UNIQUE INDEX capture_fingerprint ON capture (fingerprint) WHERE lifecycle = 'live' AND fingerprint IS NOT NULL;

-- The channels a capture has, and how its values came to their unit.
CREATE TABLE channel (
    capture_id    INTEGER NOT NULL REFERENCES capture (id) ON DELETE CASCADE,
    channel       TEXT    NOT NULL,
    unit          TEXT    NOT NULL,
    resolution    REAL    CHECK (resolution > 0),           -- smallest step that is sent, in unit; NULL where not known
    original_unit TEXT,                                     -- of an imported recording, where it was another
    factor        REAL,                                     -- value = original value × factor
    PRIMARY KEY (capture_id, channel)
) STRICT, WITHOUT ROWID;

-- The longest stretches without a gap, at one rate and one configuration.
CREATE TABLE segment (
    capture_id           INTEGER NOT NULL REFERENCES capture (id) ON DELETE CASCADE,
    segment_id           INTEGER NOT NULL CHECK (segment_id > 0),  -- from 1 within the capture
    epoch                INTEGER NOT NULL CHECK (epoch > 0),       -- one run of the sensor's clock
    first_seq            INTEGER NOT NULL CHECK (first_seq >= 0),
    samples              INTEGER NOT NULL DEFAULT 0 CHECK (samples >= 0),
    rate_hz              REAL    NOT NULL CHECK (rate_hz > 0),
    timebase             TEXT    NOT NULL CHECK (timebase IN ('device', 'sync_counter', 'arrival', 'stamps', 'rate')),
    channels             TEXT    NOT NULL CHECK (json_valid(channels)),  -- names, a JSON array
    first_device_time_ns INTEGER,
    last_device_time_ns  INTEGER,
    first_utc_ns         INTEGER NOT NULL,
    last_utc_ns          INTEGER,
    PRIMARY KEY (capture_id, segment_id)
) STRICT, WITHOUT ROWID;

-- One row per sample. No foreign key: a check per row would cost the writer more than the row; `vn100d check` looks.
CREATE TABLE sample (
    capture_id     INTEGER NOT NULL,
    segment_id     INTEGER NOT NULL,
    seq            INTEGER NOT NULL,   -- from 0 within the capture, without holes
    device_time_ns INTEGER,
    host_mono_ns   INTEGER NOT NULL,
    host_utc_ns    INTEGER NOT NULL,
    yaw            REAL,               -- deg
    pitch          REAL,               -- deg
    roll           REAL,               -- deg
    mag_x          REAL,               -- gauss
    mag_y          REAL,               -- gauss
    mag_z          REAL,               -- gauss
    accel_x        REAL,               -- m/s²
    accel_y        REAL,               -- m/s²
    accel_z        REAL,               -- m/s²
    gyro_x         REAL,               -- rad/s
    gyro_y         REAL,               -- rad/s
    gyro_z         REAL,               -- rad/s
    temperature    REAL,               -- °C
    pressure       REAL,               -- kPa
    sync_count     INTEGER,            -- serial count of ASCII messages, where they carry one
    PRIMARY KEY (capture_id, seq)
) STRICT, WITHOUT ROWID;

-- Intervals with missing samples.
CREATE TABLE gap (
    gap_id         INTEGER PRIMARY KEY,
    capture_id     INTEGER NOT NULL REFERENCES capture (id) ON DELETE CASCADE,
    before_seq     INTEGER NOT NULL CHECK (before_seq >= 0),  -- it lies between before_seq − 1 and before_seq
    from_utc_ns    INTEGER NOT NULL,
    to_utc_ns      INTEGER NOT NULL,
    from_device_ns INTEGER,
    to_device_ns   INTEGER,
    missing        INTEGER NOT NULL CHECK (missing >= 0),
    missing_exact  INTEGER NOT NULL CHECK (missing_exact IN (0, 1)),
    cause          TEXT    NOT NULL CHECK (cause IN ('unplugged', 'sensor_reset', 'silent', 'checksum', 'rate_change',
        'format_change', 'host_stall', 'host_suspend', 'daemon_stopped', 'storage_backpressure', 'source')),
    UNIQUE (capture_id, before_seq, from_utc_ns, to_utc_ns, cause)
) STRICT;

-- What arrived and did not become a sample (bytes for garbage_bytes, frames otherwise).
CREATE TABLE rejected (
    capture_id INTEGER NOT NULL REFERENCES capture (id) ON DELETE CASCADE,
    cause      TEXT    NOT NULL,
    count      INTEGER NOT NULL CHECK (count >= 0),
    PRIMARY KEY (capture_id, cause)
) STRICT, WITHOUT ROWID;

CREATE TABLE event (
    event_id   INTEGER PRIMARY KEY,
    capture_id INTEGER NOT NULL REFERENCES capture (id) ON DELETE CASCADE,
    utc_ns     INTEGER NOT NULL,
    kind       TEXT    NOT NULL,
    message    TEXT    NOT NULL,
    detail     TEXT    CHECK (detail IS NULL OR json_valid(detail))
) STRICT;
CREATE INDEX event_of_capture ON event (capture_id, event_id);

-- The sensor's description and registers, as read at each connection.
CREATE TABLE configuration (
    configuration_id INTEGER PRIMARY KEY,
    capture_id       INTEGER NOT NULL REFERENCES capture (id) ON DELETE CASCADE,
    utc_ns           INTEGER NOT NULL,
    before_seq       INTEGER NOT NULL CHECK (before_seq >= 0),  -- the samples from here on were taken with it
    registers        TEXT    NOT NULL CHECK (json_valid(registers))
) STRICT;
CREATE INDEX configuration_of_capture ON configuration (capture_id, configuration_id);

-- The number of the last batch: tells after a failed commit whether the batch is there all the same.
CREATE TABLE writer (
    id    INTEGER PRIMARY KEY CHECK (id = 1),
    batch INTEGER NOT NULL
) STRICT;
INSERT INTO writer (id, batch) VALUES (1, 0);
