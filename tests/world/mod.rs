//! The world of a test: an emulated sensor and the built daemon in separate folders.

#![allow(dead_code, reason = "each test binary uses its part")]

use std::io::{BufRead, BufReader, Read, Write as _};
use std::path::PathBuf;
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

/// Returns the built program.
pub fn program() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_vn100d"));
    for name in ["VN100D_DATA_DIR", "VN100D_CONFIG", "STATE_DIRECTORY", "NOTIFY_SOCKET", "RUST_LOG"] {
        command.env_remove(name);
    }
    command
}

/// Runs the program to its end.
pub fn vn100d(arguments: &[&str]) -> Output {
    program().args(arguments).output().unwrap()
}

/// A running child that does not outlive its test.
pub struct Process {
    child: Child,
    /// Its messages on standard error so far, collected by a thread.
    log: std::sync::Arc<std::sync::Mutex<String>>,
    pub first_line: String,
    /// The link, which is removed with the process: otherwise it would soon lead to the terminal of another test's
    /// sensor.
    link: Option<PathBuf>,
}

impl Process {
    pub fn start(command: &mut Command, wait_for_line: bool) -> Self {
        let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        let log = std::sync::Arc::new(std::sync::Mutex::new(String::new()));
        let (errors, shared) = (child.stderr.take().unwrap(), log.clone());
        std::thread::spawn(move || {
            for line in BufReader::new(errors).lines().map_while(Result::ok) {
                let mut log = shared.lock().unwrap();
                log.push_str(&line);
                log.push('\n');
            }
        });
        let mut output = BufReader::new(child.stdout.take().unwrap());
        let mut first_line = String::new();
        if wait_for_line {
            output.read_line(&mut first_line).unwrap();
        }
        std::thread::spawn(move || {
            let mut rest = Vec::new();
            let _ = output.read_to_end(&mut rest);
        });
        Self { child, log, first_line: first_line.trim().to_owned(), link: None }
    }

    pub fn log(&self) -> String {
        self.log.lock().unwrap().clone()
    }

    pub fn is_running(&mut self) -> bool {
        self.child.try_wait().unwrap().is_none()
    }

    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// Writes a line to its standard input: a fault, for an emulator that was started with `--faults -`.
    pub fn send_line(&mut self, line: &str) {
        let input = self.child.stdin.as_mut().unwrap();
        writeln!(input, "{line}").unwrap();
        input.flush().unwrap();
    }

    /// Ends it as systemd would, and returns its exit code.
    pub fn terminate(&mut self) -> Option<i32> {
        let pid = rustix::process::Pid::from_child(&self.child);
        let _ = rustix::process::kill_process(pid, rustix::process::Signal::TERM);
        self.wait(Duration::from_secs(15))
    }

    /// Ends it as a power loss would.
    pub fn kill(&mut self) {
        self.unlink();
        let _ = self.child.kill();
        let _ = self.child.wait();
    }

    fn unlink(&mut self) {
        let ours = |link: &PathBuf| std::fs::read_link(link).is_ok_and(|to| to.as_os_str() == self.first_line.as_str());
        // The next sensor may have taken the name already.
        if let Some(link) = self.link.take().filter(ours) {
            let _ = std::fs::remove_file(link);
        }
    }

    /// Sends it a signal.
    pub fn signal(&self, signal: rustix::process::Signal) {
        rustix::process::kill_process(rustix::process::Pid::from_child(&self.child), signal).unwrap();
    }

    pub fn wait(&mut self, patience: Duration) -> Option<i32> {
        self.ended(patience).code()
    }

    /// Waits for its end, by itself or by a signal; returns its exit status.
    pub fn ended(&mut self, patience: Duration) -> std::process::ExitStatus {
        let deadline = Instant::now() + patience;
        while Instant::now() < deadline {
            if let Some(status) = self.child.try_wait().unwrap() {
                return status;
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        panic!("the process did not end within {patience:?}; it said:\n{}", self.log());
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        self.kill();
    }
}

/// A folder with everything that belongs to one test.
pub struct World {
    pub folder: tempfile::TempDir,
    pub url: String,
    listen: String,
}

impl World {
    pub fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        // A port that was free a moment ago.
        let port = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
        let listen = format!("127.0.0.1:{port}");
        Self { folder, url: format!("http://{listen}"), listen }
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub fn port(&self) -> PathBuf {
        self.path("sensor")
    }

    pub fn database(&self) -> PathBuf {
        self.path("data").join("vn100d.db")
    }

    /// Returns an emulated sensor behind [`World::port`].
    pub fn emulate(&self, arguments: &[&str]) -> Process {
        let mut command = program();
        command.arg("emulate").arg("--link").arg(self.port()).args(arguments);
        let mut process = Process::start(&mut command, true);
        process.link = Some(self.port());
        assert!(process.first_line.starts_with("/dev/pts/"), "{} {}", process.first_line, process.log());
        process
    }

    /// Starts the daemon on that port with this configuration; returns once its HTTP interface answers.
    pub fn daemon(&self, configuration: &str, arguments: &[&str]) -> Process {
        self.daemon_on(self.port().to_str().unwrap(), configuration, arguments)
    }

    /// Starts the daemon as [`Self::daemon`] does, on another port or pattern.
    pub fn daemon_on(&self, device: &str, configuration: &str, arguments: &[&str]) -> Process {
        self.daemon_of(program(), device, configuration, arguments)
    }

    /// Starts the daemon as [`Self::daemon_on`] does, through this command.
    pub fn daemon_of(&self, command: Command, device: &str, configuration: &str, arguments: &[&str]) -> Process {
        let process = self.start_daemon(command, device, configuration, arguments);
        self.until("the daemon answers", Duration::from_secs(20), || self.try_get("/healthz").map(|_| ()), &process);
        process
    }

    /// Starts the daemon as [`Self::daemon_of`] does, without waiting for an answer.
    pub fn start_daemon(&self, mut command: Command, device: &str, configuration: &str, arguments: &[&str]) -> Process {
        let config = self.path("vn100d.toml");
        std::fs::write(&config, configuration).unwrap();
        command
            .args(["--data-dir", self.path("data").to_str().unwrap(), "--config", config.to_str().unwrap()])
            .args(["run", "--listen", &self.listen, "--device", device])
            .args(arguments);
        Process::start(&mut command, false)
    }

    pub fn try_get(&self, route: &str) -> Option<serde_json::Value> {
        let (status, body) = self.request("GET", route, "")?;
        (status == 200).then(|| serde_json::from_str(&body).unwrap_or(serde_json::Value::String(body)))
    }

    pub fn get(&self, route: &str) -> serde_json::Value {
        self.try_get(route).unwrap_or_else(|| panic!("GET {route}: {:?}", self.request("GET", route, "")))
    }

    /// Returns status and body of a request; `None` if nothing answers.
    pub fn request(&self, method: &str, route: &str, body: &str) -> Option<(u16, String)> {
        self.request_as(method, route, "application/json", body)
    }

    /// Returns status and body of a request with a body of this media type; `None` if nothing answers.
    pub fn request_as(&self, method: &str, route: &str, media: &str, body: &str) -> Option<(u16, String)> {
        let agent: ureq::Agent = ureq::Agent::config_builder()
            .http_status_as_error(false)
            .timeout_global(Some(Duration::from_secs(20)))
            .build()
            .into();
        let url = format!("{}{route}", self.url);
        let answer = match method {
            "GET" => agent.get(&url).call(),
            "DELETE" => agent.delete(&url).call(),
            "POST" => agent.post(&url).header("content-type", media).send(body),
            "PATCH" => agent.patch(&url).header("content-type", media).send(body),
            other => panic!("{other}"),
        };
        let mut answer = answer.ok()?;
        let status = answer.status().as_u16();
        Some((status, answer.body_mut().read_to_string().ok()?))
    }

    /// Waits until `condition` returns a value; returns the value.
    pub fn until<T>(
        &self,
        what: &str,
        patience: Duration,
        mut condition: impl FnMut() -> Option<T>,
        daemon: &Process,
    ) -> T {
        let deadline = Instant::now() + patience;
        loop {
            if let Some(result) = condition() {
                return result;
            }
            if Instant::now() > deadline {
                let status = self.request("GET", "/v1/status", "");
                panic!("{what}: not within {patience:?}; status {status:?}; the daemon said:\n{}", daemon.log());
            }
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Returns the rows of a query, as any SQLite client sees them.
    pub fn query(&self, sql: &str) -> Vec<Vec<rusqlite::types::Value>> {
        let connection =
            rusqlite::Connection::open_with_flags(self.database(), rusqlite::OpenFlags::SQLITE_OPEN_READ_ONLY).unwrap();
        let mut statement = connection.prepare(sql).unwrap();
        let columns = statement.column_count();
        let rows = statement.query_map([], |row| (0..columns).map(|column| row.get(column)).collect()).unwrap();
        rows.map(Result::unwrap).collect()
    }
}
