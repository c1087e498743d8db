-- Sensor models that somebody has left here (contract, section 5), to be named by their id.

CREATE TABLE model (
    model_id       INTEGER PRIMARY KEY AUTOINCREMENT,   -- the interface says model-1, model-2…: a number alone is a capture
    name           TEXT    NOT NULL,
    rate_hz        REAL    NOT NULL CHECK (rate_hz > 0),
    created_utc_ns INTEGER NOT NULL,
    body           TEXT    NOT NULL CHECK (json_valid(body))
) STRICT;
-- Diagnoses of all captures, the latest first.
CREATE INDEX job_of_kind ON job (kind, id);
