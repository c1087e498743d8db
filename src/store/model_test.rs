//! The store against a model of it (`model`): random work, power losses, crashes and a disk that refuses, without root.
//!
//! After each step the files before and after it are known, and the possible remains of a power loss between them are
//! made from both. Every such image must pass `check` and hold exactly one of the states that the store went through,
//! none older than the last acknowledged one. The disk refuses with a limit on the size of files, which cuts a write
//! anywhere. The limit applies to the process, so the test runs in a separate process. `VN100D_MODEL_CASES` makes it
//! longer, `VN100D_MODEL_SEED` selects another run.

mod model;

use super::*;
use imu_core::sample::{Channel, Record};
use model::{Content, Files, Instant};
use proptest::prelude::*;
use proptest::strategy::ValueTree;
use proptest::test_runner::{Config, RngAlgorithm, TestRng, TestRunner};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use std::collections::BTreeMap;

/// An operation on the store. A capture is chosen by its place among those that run.
#[derive(Debug, Clone)]
enum Action {
    Create,
    Send {
        capture: usize,
        missing: u64,
        samples: u64,
        duplicates: u64,
    },
    /// Records are sent while no file may grow beyond this many bytes more than the log has.
    Refused {
        samples: u64,
        room: u64,
    },
    End {
        capture: usize,
    },
    Import {
        samples: u64,
    },
    FinishImport,
    Submit,
    Work {
        finish: bool,
    },
    Delete,
    Purge,
    Reader {
        opens: bool,
    },
    Checkpoint {
        truncates: bool,
    },
    Restart,
    /// The power fails, and only the last image remains.
    Crash,
}

fn action() -> impl Strategy<Value = Action> {
    prop_oneof![
        2 => Just(Action::Create),
        12 => (0..3_usize, prop_oneof![2 => Just(0), 1 => 1..50_u64], 1..1500_u64, 0..3_u64)
            .prop_map(|(capture, missing, samples, duplicates)| Action::Send { capture, missing, samples, duplicates }),
        1 => (1..1500_u64, 0..200_000_u64).prop_map(|(samples, room)| Action::Refused { samples, room }),
        1 => (0..3_usize).prop_map(|capture| Action::End { capture }),
        2 => (1..9000_u64).prop_map(|samples| Action::Import { samples }),
        1 => Just(Action::FinishImport),
        2 => Just(Action::Submit),
        3 => any::<bool>().prop_map(|finish| Action::Work { finish }),
        1 => Just(Action::Delete),
        3 => Just(Action::Purge),
        3 => any::<bool>().prop_map(|opens| Action::Reader { opens }),
        2 => any::<bool>().prop_map(|truncates| Action::Checkpoint { truncates }),
        1 => Just(Action::Restart),
        3 => Just(Action::Crash),
    ]
}

impl Files {
    fn read(path: &Path) -> Self {
        let read = |path: PathBuf| std::fs::read(path).unwrap_or_default();
        Self { database: read(path.into()), log: read(paths::wal_path(path)), lock: read(paths::lock_path(path)) }
    }

    /// Returns the database's path, in a new folder.
    fn write(&self) -> (tempfile::TempDir, PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("vn100d.db");
        std::fs::write(&path, &self.database).unwrap();
        std::fs::write(paths::wal_path(&path), &self.log).unwrap();
        std::fs::write(paths::lock_path(&path), &self.lock).unwrap();
        (folder, path)
    }
}

/// Reads a database that passes its check; every value of every sample must be the one that was sent.
fn read(path: &Path) -> Content {
    assert_eq!(check(path).unwrap().findings, []);
    let reader = Reader::open(path).unwrap();
    let mut content = Content::default();
    let page = PageRequest { limit: Some(1000), ..PageRequest::default() };
    for row in reader.captures(None, &page).unwrap().rows {
        let gaps = reader.gaps(row.id, &page).unwrap().rows.iter().map(|gap| (gap.before_seq, gap.missing)).collect();
        let segments = reader.segments(row.id, &page).unwrap().rows.iter().map(|segment| segment.first_seq).collect();
        let chunk = reader.read_samples(row.id, 0, 1_000_000, &[Channel::GyroX, Channel::AccelZ]).unwrap();
        assert_eq!(chunk.len() as u64, row.samples);
        for (seq, (gyro, accel)) in chunk.columns[0].iter().zip(&chunk.columns[1]).enumerate() {
            assert_eq!((*gyro, *accel), (seq as f64 * 1e-6, -9.8 - seq as f64 * 1e-3), "sample {seq}");
        }
        let (discarded, ended) = (row.rejected.values().sum(), row.state == CaptureState::Complete);
        content.captures.insert(row.id, model::Capture { samples: row.samples, segments, gaps, discarded, ended });
    }
    let sql = "SELECT id, capture_id, state, (SELECT state FROM job_checkpoint WHERE job_id = job.id) FROM job \
               WHERE (SELECT lifecycle FROM capture WHERE id = capture_id) = 'live'";
    let mut jobs = reader.connection.prepare(sql).unwrap();
    let mut rows = jobs.query([]).unwrap();
    while let Some(row) = rows.next().unwrap() {
        let state = row.get::<_, String>(2).unwrap().parse().unwrap();
        content.jobs.insert(row.get(0).unwrap(), (row.get(1).unwrap(), state, row.get(3).unwrap()));
    }
    content
}

struct Driver {
    _folder: tempfile::TempDir,
    store: Store,
    readers: Vec<Reader>,
    import: Option<(Import, model::Capture)>,
    /// The states of the store since the last one that is known to be synced.
    states: Vec<Content>,
    safe: Files,
    /// The files that the last power loss would have left.
    image: (Files, Content),
    random: ChaCha8Rng,
    images: BTreeMap<&'static str, u64>,
    mutant: Mutant,
}

/// A store that is broken on purpose.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Mutant {
    /// It works correctly.
    None,
    /// It loses the last of the records that are sent together.
    LosesARecord,
    /// It stores a sample with another value.
    ChangesAValue,
    /// It acknowledges before the commit is on the disk.
    AcknowledgesEarly,
    /// It writes a checkpoint in two transactions.
    SplitsATransaction,
}

impl Mutant {
    /// Returns the records as such a store would store them.
    fn changed(self, mut records: Vec<Record>) -> Vec<Record> {
        match self {
            Self::LosesARecord if records.len() > 1 => drop(records.pop()),
            Self::ChangesAValue => {
                let last = records.iter_mut().rev().find_map(|record| match record {
                    Record::Sample { sample, .. } => Some(sample),
                    _ => None,
                });
                last.into_iter().for_each(|sample| sample.set(Channel::GyroX, 0.5));
            }
            _ => {}
        }
        records
    }
}

impl Driver {
    fn new(seed: u64) -> Self {
        let (folder, path) = Files::default().write();
        let store = Store::open(&path, StoreOptions::default()).unwrap();
        let mut driver = Self {
            _folder: folder,
            store,
            readers: Vec::new(),
            import: None,
            states: vec![Content::default()],
            safe: Files::default(),
            image: Default::default(),
            random: ChaCha8Rng::seed_from_u64(seed),
            images: BTreeMap::new(),
            mutant: Mutant::None,
        };
        driver.safe = driver.files();
        driver.image = (driver.safe.clone(), Content::default());
        driver
    }

    /// Returns the files between two transactions.
    fn files(&self) -> Files {
        let path = self.store.path().to_owned();
        self.store.execute(move |_| Ok(Files::read(&path))).unwrap()
    }

    fn now(&self) -> Content {
        self.states.last().cloned().unwrap_or_default()
    }

    /// Records that the store advanced to `content` in this many transactions; `None` means that the number is not
    /// known.
    fn went_on(&mut self, content: Content, transactions: Option<u64>, synced: bool) {
        self.states.push(content);
        let mut after = self.files();
        if self.mutant == Mutant::AcknowledgesEarly && after.log.len() > self.safe.log.len() {
            // The end of the log is still in memory.
            after.log.truncate(self.safe.log.len());
        }
        let one = transactions.is_some_and(|count| count <= 1);
        let copied = self.safe.database != after.database;
        for at in self.safe.instants(&after, one) {
            let image = self.safe.lost(&after, at, &mut self.random);
            let (allowed, name) = match at {
                Instant::Header => (0..1, "header"),
                Instant::Log => (0..self.states.len(), "log"),
                Instant::Copy => (self.states.len() - 1..self.states.len(), "copy"),
                Instant::Done => (self.states.len() - 1..self.states.len(), "done"),
            };
            let (_folder, path) = image.write();
            let found = read(&path);
            assert!(self.states[allowed].contains(&found), "{name}: {found:#?} is none of {:#?}", self.states);
            *self.images.entry(name).or_default() += 1;
            if at != Instant::Done || self.random.random_bool(0.3) {
                self.image = (image, found);
            }
        }
        if synced || copied {
            self.states.drain(..self.states.len() - 1);
            self.safe = after;
        }
    }

    /// Sends the records and waits until they are acknowledged.
    fn send(&mut self, id: i64, records: Vec<Record>, room: Option<u64>) {
        let mut content = self.now();
        let capture = content.captures.get_mut(&id).unwrap();
        records.iter().for_each(|record| capture.apply(record));
        let samples = capture.samples;
        let before = self.store.progress();
        let log = std::fs::metadata(paths::wal_path(self.store.path())).map_or(0, |file| file.len());
        if let Some(room) = room {
            limit(Some(log.max(1 << 16) + room));
        }
        for record in self.mutant.changed(records) {
            self.store.records().blocking_send(id, record).unwrap();
        }
        let begun = std::time::Instant::now();
        while room.is_some() && begun.elapsed() < COMMIT_AFTER * 2 {
            let progress = self.store.progress();
            if progress.figures.failures > before.figures.failures {
                assert_eq!(
                    progress.committed.get(&id),
                    before.committed.get(&id),
                    "acknowledged by a disk that refused"
                );
                *self.images.entry("refused").or_default() += 1;
                break;
            }
            std::thread::sleep(Duration::from_millis(2));
        }
        limit(None);
        self.store.flush_blocking().unwrap();
        let after = self.store.progress();
        assert_eq!(after.committed[&id], samples);
        let sound = after.figures.failures == before.figures.failures;
        self.went_on(content, Some(after.figures.commits - before.figures.commits).filter(|_| sound), true);
    }

    fn reopen(&mut self, image: Option<(Files, Content)>) {
        self.readers.clear();
        self.import = None;
        let content = match image {
            Some((files, content)) => {
                let (folder, path) = files.write();
                self.store = Store::open(&path, StoreOptions::default()).unwrap();
                self._folder = folder;
                content
            }
            None => {
                let path = self.store.path().to_owned();
                self.store.close().unwrap();
                self.store = Store::open(&path, StoreOptions::default()).unwrap();
                self.now()
            }
        };
        let content = content.after_start();
        assert_eq!(read(self.store.path()), content);
        self.states = vec![content.clone()];
        self.safe = self.files();
        self.image = (self.safe.clone(), content);
    }

    fn run(&mut self, action: &Action) {
        let mut content = self.now();
        let running: Vec<i64> =
            content.captures.iter().filter(|(_, capture)| !capture.ended).map(|(id, _)| *id).collect();
        let chosen = |nth: usize| (!running.is_empty()).then(|| running[nth % running.len()]);
        match *action {
            Action::Create if running.len() < 3 => {
                let id = self.store.create_capture(NewCapture::new("pty", CaptureState::Capturing)).unwrap();
                content.captures.insert(id, model::Capture::default());
                self.went_on(content, Some(1), true);
            }
            Action::Send { capture, missing, samples, duplicates } => {
                let Some(id) = chosen(capture) else { return self.run(&Action::Create) };
                self.send(id, content.captures[&id].next(missing, samples, duplicates), None);
            }
            Action::Refused { samples, room } => {
                let Some(id) = chosen(0) else { return };
                self.send(id, content.captures[&id].next(0, samples, 0), Some(room));
            }
            Action::End { capture } => {
                let Some(id) = chosen(capture) else { return };
                self.send(id, vec![content.captures[&id].end()], None);
            }
            Action::Import { samples } => {
                let mut begun = self.import.take();
                if begun.is_none() {
                    let capture = NewCapture::new("file", CaptureState::Complete);
                    let import = self.store.begin_import(capture, None).unwrap();
                    self.went_on(content.clone(), Some(1), true);
                    begun = Some((import, model::Capture { ended: true, ..Default::default() }));
                }
                let (mut import, mut capture) = begun.unwrap();
                for record in capture.next(0, samples, 0) {
                    capture.apply(&record);
                    import.push(record).unwrap();
                }
                self.import = Some((import, capture));
                self.went_on(content, None, false);
            }
            Action::FinishImport => {
                let Some((import, capture)) = self.import.take() else { return };
                let id = import.finish(None).unwrap().id();
                content.captures.insert(id, capture);
                self.went_on(content, Some(2), true);
            }
            Action::Submit => {
                let Some(id) = content.captures.keys().next().copied() else { return };
                let params = serde_json::json!({ "n": self.random.random::<u32>() });
                let (job, new) = self.store.submit_job(NewJob::new(JobKind::Allan, id, params), 1000).unwrap();
                assert!(new);
                content.jobs.insert(job.id, (id, JobState::Queued, None));
                self.went_on(content, Some(1), true);
            }
            Action::Work { finish } => {
                let Some(id) = content.running() else {
                    let Some(job) = self.store.claim_job().unwrap() else { return };
                    content.jobs.get_mut(&job.id).unwrap().1 = JobState::Running;
                    return self.went_on(content, Some(1), true);
                };
                let job = content.jobs.get_mut(&id).unwrap();
                if finish {
                    assert!(self.store.finish_job(id, "{}".to_owned()).unwrap().is_some());
                    (job.1, job.2) = (JobState::Done, None);
                } else {
                    let state: Vec<u8> = (0..self.random.random_range(0..9000)).map(|_| self.random.random()).collect();
                    job.2 = Some(state.clone());
                    if self.mutant == Mutant::SplitsATransaction {
                        let half = JobCheckpoint { next_seq: 0, state: vec![0; state.len()] };
                        assert!(self.store.checkpoint_job(id, half, 0.5).unwrap());
                    }
                    assert!(self.store.checkpoint_job(id, JobCheckpoint { next_seq: 0, state }, 0.5).unwrap());
                }
                self.went_on(content, Some(1), true);
            }
            Action::Delete => {
                let ended = content.captures.iter().find(|(_, capture)| capture.ended).map(|(id, _)| *id);
                let Some(id) = ended else { return };
                self.store.delete_capture(id).unwrap();
                content.captures.remove(&id);
                content.jobs.retain(|_, job| job.0 != id);
                self.went_on(content, Some(1), true);
            }
            Action::Purge => {
                if self.store.purge_step().unwrap() {
                    self.went_on(content, Some(1), true);
                }
            }
            Action::Reader { opens: true } => {
                let reader = self.store.reader().unwrap();
                reader.connection.execute_batch("BEGIN; SELECT count(*) FROM capture").unwrap();
                self.readers.push(reader);
            }
            Action::Reader { opens: false } => drop(self.readers.pop()),
            Action::Checkpoint { truncates } => {
                let foreign = rusqlite::Connection::open(self.store.path()).unwrap();
                // Do not wait for a reader that prevents it.
                foreign.busy_timeout(Duration::ZERO).unwrap();
                let how = if truncates { "TRUNCATE" } else { "PASSIVE" };
                foreign.query_row(&format!("PRAGMA wal_checkpoint({how})"), [], |_| Ok(())).unwrap();
                self.went_on(content, Some(0), true);
            }
            Action::Restart => self.reopen(None),
            Action::Crash => self.reopen(Some(self.image.clone())),
            Action::Create => {}
        }
    }
}

/// Limits the size of every file of this process, or removes the limit.
fn limit(bytes: Option<u64>) {
    let maximum = getrlimit(Resource::Fsize).maximum;
    setrlimit(Resource::Fsize, Rlimit { current: bytes, maximum }).unwrap();
}

fn from_env(name: &str, otherwise: u64) -> u64 {
    std::env::var(name).ok().and_then(|text| text.parse().ok()).unwrap_or(otherwise)
}

/// The model must notice the loss of an acknowledged commit that was not synced: the check can fail.
#[test]
fn the_model_notices_that_an_acknowledged_sample_is_gone() {
    let mut driver = Driver::new(1);
    driver.run(&Action::Create);
    let before = driver.safe.clone();
    driver.run(&Action::Send { capture: 0, missing: 0, samples: 100, duplicates: 0 });
    let (_folder, path) = driver.safe.write();
    assert_eq!(read(&path), driver.now());
    for unsynced in [before.log.len(), driver.safe.log.len() - 1] {
        let log = driver.safe.log[..unsynced].to_vec();
        let (_folder, path) = Files { log, ..driver.safe.clone() }.write();
        assert_ne!(read(&path), driver.now());
        assert!(Store::open(&path, StoreOptions::default()).is_err(), "the lock remembers that it was acknowledged");
    }
}

/// Each kind of broken store fails the model within some cases, and a correct one does not: the test can fail.
#[test]
fn a_store_that_is_broken_fails_its_model() {
    const CASES: u64 = 5;
    let mutants = [
        Mutant::None,
        Mutant::LosesARecord,
        Mutant::ChangesAValue,
        Mutant::AcknowledgesEarly,
        Mutant::SplitsATransaction,
    ];
    for mutant in mutants {
        let mut runner = TestRunner::deterministic();
        // A disk that refuses needs a separate process.
        let some = proptest::collection::vec(action(), 1..60)
            .prop_map(|all| all.into_iter().filter(|of| !matches!(of, Action::Refused { .. })).collect::<Vec<_>>());
        let failed = (0..CASES).position(|seed| {
            let mut actions = vec![Action::Create, Action::Submit, Action::Work { finish: false }];
            actions.extend((0..8).map(|_| Action::Work { finish: false }));
            actions.extend(some.new_tree(&mut runner).unwrap().current());
            let run = || {
                let mut driver = Driver { mutant, ..Driver::new(seed) };
                actions.iter().for_each(|action| driver.run(action));
            };
            std::panic::catch_unwind(std::panic::AssertUnwindSafe(run)).is_err()
        });
        println!("{mutant:?} failed the model in case {failed:?}");
        assert_eq!(failed.is_some(), mutant != Mutant::None, "{mutant:?}");
    }
}

#[test]
fn the_store_matches_its_model_at_any_crash() {
    const INSIDE: &str = "VN100D_MODEL_INSIDE";
    if std::env::var_os(INSIDE).is_none() {
        // A write beyond the limit returns an error only if the signal that comes with it is ignored.
        let inside = std::process::Command::new("sh")
            .args(["-c", "trap '' XFSZ; exec \"$0\" \"$@\""])
            .arg(std::env::current_exe().unwrap())
            .args(["--exact", "--nocapture", "store::model_test::the_store_matches_its_model_at_any_crash"])
            .env(INSIDE, "1")
            .output()
            .unwrap();
        let stdout = String::from_utf8_lossy(&inside.stdout);
        println!("{stdout}");
        assert!(inside.status.success(), "{}", String::from_utf8_lossy(&inside.stderr));
        assert!(stdout.contains("1 passed"));
        return;
    }
    let (cases, seed) = (from_env("VN100D_MODEL_CASES", 5), from_env("VN100D_MODEL_SEED", 1));
    let config = Config { cases: cases as u32, failure_persistence: None, max_shrink_iters: 100, ..Config::default() };
    let mut bytes = [0; 32];
    bytes[..8].copy_from_slice(&seed.to_le_bytes());
    let mut runner = TestRunner::new_with_rng(config, TestRng::from_seed(RngAlgorithm::ChaCha, &bytes));
    let images = Mutex::new(BTreeMap::<&'static str, u64>::new());
    let actions = proptest::collection::vec(action(), 1..60);
    let outcome = runner.run(&(actions, any::<u64>()), |(actions, seed)| {
        let mut driver = Driver::new(seed);
        actions.iter().for_each(|action| driver.run(action));
        let mut images = images.lock().unwrap_or_else(PoisonError::into_inner);
        driver.images.iter().for_each(|(name, count)| *images.entry(name).or_default() += count);
        Ok(())
    });
    println!("{cases} cases of seed {seed}: {:?}", images.lock().unwrap_or_else(PoisonError::into_inner));
    if let Err(error) = outcome {
        panic!("seed {seed}: {error}");
    }
}
