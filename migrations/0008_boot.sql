-- Which boot of the host a segment's host_mono_ns belong to (/proc/sys/kernel/random/boot_id): within one boot the monotonic
-- clock tells how long the daemon was away, whatever became of civil time. NULL: not known, or a clock of its own.

ALTER TABLE segment ADD COLUMN boot_id TEXT;
