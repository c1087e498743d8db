-- Accounting: what was received is counted apart from what became of it.

-- Valid measurements that left the decoder while the capture was on, discarded ones included, as of the last commit:
-- samples + the frames in table rejected. NULL for a capture of a version that did not count them.
ALTER TABLE capture ADD COLUMN received INTEGER CHECK (received >= 0);

-- The sensor's clock against the host's, as last estimated in each epoch.
CREATE TABLE device_clock (
    capture_id           INTEGER NOT NULL REFERENCES capture (id) ON DELETE CASCADE,
    epoch                INTEGER NOT NULL,
    skew_ppm             REAL    NOT NULL,   -- how much faster than the host's the sensor's clock runs
    skew_ppm_uncertainty REAL    NOT NULL,
    offset_s             REAL    NOT NULL,   -- host monotonic minus device time at the last sample
    latency_mean_ms      REAL    NOT NULL,   -- beyond the quickest arrivals
    latency_max_ms       REAL    NOT NULL,
    span_s               REAL    NOT NULL,   -- time of the sensor that it rests on
    PRIMARY KEY (capture_id, epoch)
) STRICT, WITHOUT ROWID;
