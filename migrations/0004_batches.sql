-- What each commit added, with a checksum of the values: damage shows where SQLite's own check sees only structure.
-- crc: CRC-32 (IEEE 802.3) over the rows' values in the order of seq; docs/data-model.md says how a row is put in bytes.

CREATE TABLE batch (
    capture_id INTEGER NOT NULL REFERENCES capture (id) ON DELETE CASCADE,
    first_seq  INTEGER NOT NULL CHECK (first_seq >= 0),
    count      INTEGER NOT NULL CHECK (count > 0),
    number     INTEGER NOT NULL,    -- of the writer's commit; 0 for an import
    crc        INTEGER NOT NULL CHECK (crc BETWEEN 0 AND 4294967295),
    PRIMARY KEY (capture_id, first_seq)
) STRICT, WITHOUT ROWID;

-- Names the request that made the capture: the same request given again makes it once.
ALTER TABLE capture ADD COLUMN token TEXT;
CREATE UNIQUE INDEX capture_token ON capture (token) WHERE token IS NOT NULL;

-- Tells this database from a copy of it, so that a log or a file that was taken away is noticed.
ALTER TABLE writer ADD COLUMN identity TEXT NOT NULL DEFAULT '';
UPDATE writer SET identity = lower(hex(randomblob(16)));
