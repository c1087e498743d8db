//! Parts: some of a capture's samples and channels, as the only capture of a database for a while.
//!
//! Segments, rates, times, gaps and causes are those of the capture, cut at the ends: nothing is found again from the times.

use super::reader::Reader;
use super::{CaptureRow, SampleRange, StoreError, schema};
use imu_core::sample::Channel;
use imu_core::units::period_ns;
use rusqlite::types::ToSqlOutput;
use rusqlite::{Connection, Params, params};
use std::fs::Permissions;
use std::os::unix::fs::PermissionsExt as _;

/// Samples copied in one query, so that no read transaction lasts.
const ROWS_PER_QUERY: u64 = 65_536;

impl SampleRange {
    /// Returns the samples of the range, of which there must be some, with these channels, as a capture of a database that is removed with its reader. The
    /// capture keeps its id, name, sensor and configuration. What was rejected is that of the whole, because it has no time.
    ///
    /// # Errors
    /// [`StoreError::Create`] if no temporary file can be made, one for which [`StoreError::is_interrupted`] holds once `is_wanted`
    /// returns `false`, or the error that one of the databases reports.
    pub fn apart(
        mut self,
        reader: &Reader,
        channels: &[Channel],
        is_wanted: &dyn Fn() -> bool,
    ) -> Result<(Reader, CaptureRow), StoreError> {
        let folder = tempfile::Builder::new()
            .prefix("vn100d-")
            .permissions(Permissions::from_mode(0o700))
            .tempdir()
            .map_err(|source| StoreError::Create { path: std::env::temp_dir(), source })?;
        let path = folder.path().join("part.db");
        let part = schema::for_a_while(&path)?;
        self.copy_about(reader, &part, channels)?;
        self.copy_samples(reader, &part, channels, is_wanted)?;
        self.count(&part)?;
        part.close().map_err(|(_, error)| StoreError::Sqlite(error))?;
        let part = Reader::open(&path)?.within(folder);
        let row = part.capture(self.capture.id)?;
        Ok((part, row))
    }

    /// Copies everything but the samples.
    fn copy_about(&mut self, reader: &Reader, part: &Connection, channels: &[Channel]) -> Result<(), StoreError> {
        let (id, from, to) = (self.capture.id, self.from_seq as i64, self.to_seq as i64);
        let source = &reader.connection;
        let of_capture = |table: &str| format!("SELECT * FROM {table} WHERE capture_id = ?1");
        copy(source, part, "capture", "SELECT * FROM capture WHERE id = ?1", [id])?;
        copy(source, part, "channel", &of_capture("channel"), [id])?;
        copy(source, part, "rejected", &of_capture("rejected"), [id])?;
        copy(source, part, "device_clock", &of_capture("device_clock"), [id])?;
        let segments = "SELECT * FROM segment WHERE capture_id = ?1 AND first_seq < ?3 AND first_seq + samples > ?2";
        copy(source, part, "segment", segments, params![id, from, to])?;
        copy(
            source,
            part,
            "gap",
            "SELECT * FROM gap WHERE capture_id = ?1 AND before_seq > ?2 AND before_seq < ?3",
            params![id, from, to],
        )?;
        let configurations = "SELECT * FROM configuration WHERE capture_id = ?1 AND before_seq < ?3 AND configuration_id >= \
             coalesce((SELECT max(configuration_id) FROM configuration WHERE capture_id = ?1 AND before_seq <= ?2), 0)";
        copy(source, part, "configuration", configurations, params![id, from, to])?;
        let names: Vec<&str> = channels.iter().map(|channel| channel.name()).collect();
        let names = serde_json::to_string(&names)?;
        let are_wanted = "IN (SELECT value FROM json_each(?1))";
        part.execute(&format!("DELETE FROM channel WHERE NOT channel {are_wanted}"), [&names])?;
        part.execute(
            &format!(
                "UPDATE segment SET channels = (SELECT json_group_array(value) FROM json_each(channels) WHERE value {are_wanted})"
            ),
            [&names],
        )?;
        part.execute(
            "UPDATE segment SET samples = min(first_seq + samples, ?2) - max(first_seq, ?1), first_seq = max(first_seq, ?1) - ?1",
            [from, to],
        )?;
        part.execute("DELETE FROM device_clock WHERE epoch NOT IN (SELECT epoch FROM segment)", [])?;
        part.execute("UPDATE gap SET before_seq = before_seq - ?1", [from])?;
        part.execute("UPDATE configuration SET before_seq = max(before_seq - ?1, 0)", [from])?;
        self.set_ends(reader, part)
    }

    /// Sets the times of the ends of the first and the last segment, which may be cut.
    fn set_ends(&mut self, reader: &Reader, part: &Connection) -> Result<(), StoreError> {
        let (id, origin_ns) = (self.capture.id, self.axis.origin_ns());
        let (number, device_ns, utc_ns) = reader.sample_clocks(id, self.from_seq)?;
        // Times of an epoch count from its first segment.
        let first_ns = origin_ns.saturating_add(self.axis.time_ns(reader, number, self.from_seq, device_ns, utc_ns)?);
        let sql = "UPDATE segment SET first_device_time_ns = ?2, first_utc_ns = ?3 WHERE segment_id = ?1";
        part.execute(sql, params![number, device_ns.map(|ns| ns as i64), first_ns])?;
        let (number, device_ns, utc_ns) = reader.sample_clocks(id, self.to_seq - 1)?;
        let sql = "UPDATE segment SET last_device_time_ns = ?2, last_utc_ns = ?3 WHERE segment_id = ?1";
        part.execute(sql, params![number, device_ns.map(|ns| ns as i64), utc_ns])?;
        let last_ns =
            origin_ns.saturating_add(self.axis.time_ns(reader, number, self.to_seq - 1, device_ns, utc_ns)?);
        copy(
            &reader.connection,
            part,
            "event",
            "SELECT * FROM event WHERE capture_id = ?1 AND utc_ns BETWEEN ?2 AND ?3",
            [id, first_ns, last_ns],
        )?;
        let sql = "UPDATE capture SET started_utc_ns = ?1, ended_utc_ns = iif(ended_utc_ns IS NULL, NULL, ?2), fingerprint = NULL, token = NULL, \
                   start_at_utc_ns = NULL, planned_duration_ns = NULL";
        part.execute(sql, [first_ns, last_ns])?;
        Ok(())
    }

    fn copy_samples(
        &self,
        reader: &Reader,
        part: &Connection,
        channels: &[Channel],
        is_wanted: &dyn Fn() -> bool,
    ) -> Result<(), StoreError> {
        let values: String = Channel::ALL
            .iter()
            .map(
                |channel| if channels.contains(channel) { channel.name().to_owned() } else { "NULL".to_owned() } + ", ",
            )
            .collect();
        let select = format!(
            "SELECT capture_id, segment_id, seq - ?4 AS seq, device_time_ns, host_mono_ns, host_utc_ns, {values}sync_count \
             FROM sample WHERE capture_id = ?1 AND seq >= ?2 AND seq < ?3 ORDER BY seq"
        );
        let mut next = self.from_seq;
        while next < self.to_seq {
            if !is_wanted() {
                return Err(StoreError::of_code(rusqlite::ffi::SQLITE_INTERRUPT, "no longer wanted".to_owned()));
            }
            let end = self.to_seq.min(next + ROWS_PER_QUERY);
            let range = params![self.capture.id, next as i64, end as i64, self.from_seq as i64];
            copy(&reader.connection, part, "sample", &select, range)?;
            next = end;
        }
        Ok(())
    }

    /// Sets the capture's counts to those of the part.
    fn count(&self, part: &Connection) -> Result<(), StoreError> {
        let mut sample_time_ns = 0.0;
        let mut statement = part.prepare("SELECT samples, rate_hz FROM segment")?;
        let mut rows = statement.query([])?;
        while let Some(row) = rows.next()? {
            sample_time_ns += row.get::<_, f64>(0)? * period_ns(row.get(1)?);
        }
        let mut statement = part.prepare(
            "SELECT missing, max(to_utc_ns - from_utc_ns, 0), (SELECT rate_hz FROM segment WHERE first_seq < gap.before_seq \
             ORDER BY segment_id DESC LIMIT 1) FROM gap",
        )?;
        let mut rows = statement.query([])?;
        while let Some(row) = rows.next()? {
            // As the whole capture counts it.
            sample_time_ns += (row.get::<_, f64>(0)? * period_ns(row.get(2)?)).min(row.get(1)?);
        }
        // Of the whole, received measurements are samples and rejected ones; so they are of the part.
        let sql = "UPDATE capture SET received = received - samples + ?1, samples = ?1, sample_time_ns = ?2, \
                   missing = (SELECT coalesce(sum(missing), 0) FROM gap), gaps = (SELECT count(*) FROM gap), \
                   segments = (SELECT count(*) FROM segment), \
                   rate_hz = (SELECT rate_hz FROM segment ORDER BY segment_id LIMIT 1)";
        part.execute(sql, params![self.samples() as i64, sample_time_ns.round() as i64])?;
        Ok(())
    }
}

/// Copies the selected rows, whose columns are those of the table in their order.
fn copy(
    source: &Connection,
    part: &Connection,
    table: &str,
    select: &str,
    selected: impl Params,
) -> Result<(), StoreError> {
    let mut select = source.prepare_cached(select)?;
    let columns = select.column_count();
    let transaction = part.unchecked_transaction()?;
    {
        let values = vec!["?"; columns].join(", ");
        let mut insert = transaction.prepare_cached(&format!("INSERT INTO {table} VALUES ({values})"))?;
        let mut rows = select.query(selected)?;
        while let Some(row) = rows.next()? {
            for column in 0..columns {
                insert.raw_bind_parameter(column + 1, ToSqlOutput::Borrowed(row.get_ref(column)?))?;
            }
            insert.raw_execute()?;
        }
    }
    Ok(transaction.commit()?)
}

#[cfg(test)]
mod tests {
    use super::super::tests::{World, gap, sample, segment};
    use super::super::{Moment, PageRequest};
    use super::*;
    use imu_core::sample::Record;

    /// Two segments of one clock with a gap between them, and a third after a reset, at another rate.
    fn world() -> (World, i64) {
        let world = World::new();
        let id = world.capturing();
        let after_reset = |record: Record| match record {
            Record::Segment(mut segment) => {
                (segment.epoch, segment.rate_hz, segment.first_device_time_ns) = (2, 100.0, Some(7));
                segment.channels = [Channel::GyroX].into_iter().collect();
                Record::Segment(segment)
            }
            Record::Sample { seq, segment, mut sample } => {
                sample.device_time_ns = Some(7 + (seq - 20) * 10_000_000);
                Record::Sample { seq, segment, sample }
            }
            other => other,
        };
        world.send(id, std::iter::once(segment(1, 0)).chain((0..10).map(|seq| sample(1, seq))));
        world.send(id, [gap(10, 3), segment(2, 10)].into_iter().chain((10..20).map(|seq| sample(2, seq))));
        world.send(id, [segment(3, 20)].into_iter().chain((20..30).map(|seq| sample(3, seq))).map(after_reset));
        world.wait_for("samples", |progress| progress.committed.get(&id) == Some(&30));
        (world, id)
    }

    fn range(reader: &Reader, id: i64, from_seq: u64, to_seq: u64) -> SampleRange {
        SampleRange { from_seq, to_seq, ..SampleRange::read(reader, &id.to_string(), None, None).unwrap() }
    }

    /// Returns the times of all samples, ns since 1970, and their segments.
    fn times(reader: &Reader, id: i64) -> (Vec<i64>, Vec<u32>) {
        let mut axis = SampleRange::read(reader, &id.to_string(), None, None).unwrap().axis;
        let chunk = reader.read_samples(id, 0, 100, &[]).unwrap();
        let times = axis.times(reader, &chunk).unwrap();
        (times.into_iter().map(|ns| axis.origin_ns() + ns).collect(), chunk.segment)
    }

    #[test]
    fn any_part_has_the_times_segments_rates_and_gaps_of_the_capture() {
        let (world, id) = world();
        let reader = world.reader();
        let (whole_times, whole_segments) = times(&reader, id);
        for (from, to) in (0..30_usize).flat_map(|from| (from + 1..=30).map(move |to| (from, to))) {
            let range = range(&reader, id, from as u64, to as u64);
            let (part, row) = range.apart(&reader, &[Channel::AccelZ, Channel::GyroX], &|| true).unwrap();
            assert_eq!(
                times(&part, id),
                (whole_times[from..to].to_vec(), whole_segments[from..to].to_vec()),
                "{from} {to}"
            );
            let is_gap_inside = from < 10 && to > 10;
            let rates = whole_segments[from..to].iter().map(|number| if *number == 3 { 0.01 } else { 0.025 });
            let duration_s = rates.sum::<f64>() + if is_gap_inside { 0.075 } else { 0.0 };
            assert_eq!((row.samples, row.missing), ((to - from) as u64, if is_gap_inside { 3 } else { 0 }));
            assert_eq!((row.gaps, row.id), (u64::from(is_gap_inside), id));
            assert!(row.state.is_open() && row.ended_at.is_none(), "the capture runs");
            assert!((row.duration_s - duration_s).abs() < 1e-6, "{from} {to}: {} {duration_s}", row.duration_s);
            let segments = part.segments(id, &PageRequest::first()).unwrap().rows;
            assert_eq!(segments.iter().map(|segment| segment.samples).sum::<u64>(), row.samples);
            assert_eq!((row.segments, segments[0].first_seq), (segments.len() as u64, 0));
            assert_eq!(row.rate_hz, Some(segments[0].rate_hz));
            let accounting = part.accounting(id).unwrap();
            assert_eq!(accounting, part.accounting_of_every_row(id).unwrap());
        }
        let (_, all) = range(&reader, id, 0, 30).apart(&reader, &[Channel::GyroX], &|| true).unwrap();
        assert_eq!(all.duration_s, reader.capture(id).unwrap().duration_s);
    }

    #[test]
    fn channels_that_are_not_wanted_are_not_there_and_the_folder_goes_with_the_reader() {
        let (world, id) = world();
        let reader = world.reader();
        let from = Moment::Since(100_000_000);
        let part = || SampleRange::read(&reader, "night", Some(from), None).unwrap();
        let (read, row) = part().apart(&reader, &[Channel::AccelZ], &|| true).unwrap();
        assert_eq!((row.channels, row.units.len()), (vec![Channel::AccelZ], 1));
        let chunk = read.read_chunk(id, 0, 1, &[Channel::AccelZ, Channel::GyroX]).unwrap();
        assert_eq!(chunk.columns[0], [-9.8 - 4e-3]);
        assert!(chunk.columns[1][0].is_nan());
        let path = read.connection.path().unwrap().to_owned();
        assert!(std::path::Path::new(&path).exists());
        drop(read);
        assert!(!std::path::Path::new(&path).parent().unwrap().exists());
        assert!(part().apart(&reader, &[Channel::AccelZ], &|| false).unwrap_err().is_interrupted());
    }
}
