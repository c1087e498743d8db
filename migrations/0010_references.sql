-- What a sensor went through, as a diagnosis is given it: kept once, in parts that the writer takes one at a time, and
-- deleted with the last diagnosis that has it.

CREATE TABLE reference (
    reference_id   INTEGER PRIMARY KEY AUTOINCREMENT,
    sha256         TEXT    NOT NULL UNIQUE,             -- of the whole text
    bytes          INTEGER NOT NULL CHECK (bytes >= 0),
    parts          INTEGER NOT NULL CHECK (parts > 0),  -- with so many it is whole
    claimed        INTEGER NOT NULL DEFAULT 0,          -- a job has had it: without one it goes
    created_utc_ns INTEGER NOT NULL
) STRICT;

CREATE TABLE reference_part (
    reference_part_id INTEGER PRIMARY KEY,
    reference_id      INTEGER NOT NULL REFERENCES reference (reference_id) ON DELETE CASCADE,
    part              INTEGER NOT NULL CHECK (part >= 0),
    content           BLOB    NOT NULL,
    UNIQUE (reference_id, part)
) STRICT;

ALTER TABLE job ADD COLUMN reference_id INTEGER REFERENCES reference (reference_id);
CREATE INDEX job_of_reference ON job (reference_id) WHERE reference_id IS NOT NULL;

-- Jobs had the text in their parameters and in their fingerprint.
INSERT INTO reference (sha256, bytes, parts, claimed, created_utc_ns)
    SELECT 'job-' || id, octet_length(params ->> '$.reference'), 1, 1, created_utc_ns
    FROM job WHERE kind = 'diagnosis' AND octet_length(params ->> '$.reference') > 100;
INSERT INTO reference_part (reference_id, part, content)
    SELECT reference.reference_id, 0, CAST(job.params ->> '$.reference' AS BLOB)
    FROM job JOIN reference ON reference.sha256 = 'job-' || job.id;
UPDATE job SET
    reference_id = reference.reference_id,
    params = json_set(params, '$.reference', json_object('bytes', reference.bytes, 'sha256', reference.sha256)),
    fingerprint = reference.sha256
    FROM reference WHERE reference.sha256 = 'job-' || job.id;
