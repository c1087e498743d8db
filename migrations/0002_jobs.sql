-- Durable background work and what came of it.

CREATE TABLE job (
    id              INTEGER PRIMARY KEY AUTOINCREMENT,
    kind            TEXT    NOT NULL,
    capture_id      INTEGER REFERENCES capture (id) ON DELETE CASCADE,
    params          TEXT    NOT NULL CHECK (json_valid(params)),
    end_seq         INTEGER NOT NULL CHECK (end_seq >= 0),  -- it reads samples with seq below this: fixed at submission
    fingerprint     TEXT    NOT NULL,                       -- kind, capture, range, parameters, software
    state           TEXT    NOT NULL CHECK (state IN ('queued', 'running', 'done', 'failed', 'cancelled')),
    progress        REAL    NOT NULL DEFAULT 0 CHECK (progress BETWEEN 0 AND 1),
    attempts        INTEGER NOT NULL DEFAULT 0,             -- starts since the last checkpoint
    created_utc_ns  INTEGER NOT NULL,
    started_utc_ns  INTEGER,
    finished_utc_ns INTEGER,
    error           TEXT,
    result_id       INTEGER REFERENCES result (id) ON DELETE SET NULL
) STRICT;
-- The same submission is the same job, unless it failed or was cancelled.
CREATE UNIQUE INDEX job_fingerprint ON job (fingerprint) WHERE state IN ('queued', 'running', 'done');
CREATE INDEX job_queue ON job (state, id);
CREATE INDEX job_of_capture ON job (capture_id, kind, id);

-- How far a job has come: everything it needs to go on as if it had never stopped.
CREATE TABLE job_checkpoint (
    job_id   INTEGER PRIMARY KEY REFERENCES job (id) ON DELETE CASCADE,
    next_seq INTEGER NOT NULL CHECK (next_seq >= 0),
    state    BLOB    NOT NULL
) STRICT;

CREATE TABLE result (
    id             INTEGER PRIMARY KEY AUTOINCREMENT,
    job_id         INTEGER REFERENCES job (id) ON DELETE SET NULL,
    capture_id     INTEGER REFERENCES capture (id) ON DELETE CASCADE,
    kind           TEXT    NOT NULL,
    software       TEXT    NOT NULL,
    created_utc_ns INTEGER NOT NULL,
    body           TEXT    NOT NULL CHECK (json_valid(body))
) STRICT;
CREATE INDEX result_of_capture ON result (capture_id, kind, id);
