-- Which program a job was submitted to and which one made its checkpoint: another version neither goes on from a
-- checkpoint nor takes an older failure for its own.
ALTER TABLE job ADD COLUMN software TEXT NOT NULL DEFAULT '';
ALTER TABLE job_checkpoint ADD COLUMN software TEXT NOT NULL DEFAULT '';
UPDATE job SET software = coalesce(json_extract(fingerprint, '$.software'), '') WHERE json_valid(fingerprint);
-- The last job of these parameters, for the answer while a capture still grows.
CREATE INDEX job_open ON job (capture_id, kind) WHERE state IN ('queued', 'running');
-- Where an epoch's clock began: a sample's time without reading all segments before it.
CREATE INDEX segment_of_epoch ON segment (capture_id, epoch, segment_id) WHERE first_device_time_ns IS NOT NULL;
