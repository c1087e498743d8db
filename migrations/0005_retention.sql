-- Retention: what was announced of a capture's deletion; NULL where it stays.

ALTER TABLE capture ADD COLUMN deletion_said_utc_ns INTEGER;
ALTER TABLE capture ADD COLUMN delete_at_utc_ns INTEGER;
