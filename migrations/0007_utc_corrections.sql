-- Civil times that are still to be corrected because the host's clock was set while a capture ran: done in small steps, the
-- newest rows first, so that times never run back.

CREATE TABLE utc_correction (
    correction_id INTEGER PRIMARY KEY,
    capture_id    INTEGER NOT NULL REFERENCES capture (id) ON DELETE CASCADE,
    by_ns         INTEGER NOT NULL,
    before_utc_ns INTEGER NOT NULL,    -- times before this are moved
    first_seq     INTEGER NOT NULL,    -- samples before this are of an earlier boot, or of a clock that was set back since
    first_event   INTEGER NOT NULL,    -- and events before this
    end_seq       INTEGER,             -- the first sample taken after the clock was set; NULL until it is there
    place         INTEGER NOT NULL DEFAULT 0,                    -- which table it has come to
    next_key      INTEGER NOT NULL DEFAULT 9223372036854775807   -- rows of that table below this are still to be looked at
) STRICT;
