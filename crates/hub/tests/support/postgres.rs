//! The databases of hubs: a SQLite file, or a PostgreSQL server per test, on loopback and never as root.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// The URL of the database file `hub.db` in a folder.
pub(crate) fn sqlite(folder: &Path) -> String {
    format!("sqlite:{}", folder.join("hub.db").display())
}

macro_rules! on_both {
    ($test:ident $(, $times:literal)?) => {
        mod $test {
            #[rstest::rstest]
            $(#[timeout($times * crate::support::PATIENCE)])?
            #[tokio::test(flavor = "multi_thread")]
            async fn sqlite() {
                let folder = tempfile::tempdir().unwrap();
                super::$test(&crate::support::postgres::sqlite(folder.path())).await;
            }

            #[rstest::rstest]
            $(#[timeout($times * crate::support::PATIENCE)])?
            #[tokio::test(flavor = "multi_thread")]
            #[ignore = "needs PostgreSQL"]
            async fn postgres() {
                let server = crate::support::postgres::Postgres::start();
                super::$test(&server.url()).await;
            }
        }
    };
}
pub(crate) use on_both;

pub(crate) struct Postgres {
    folder: tempfile::TempDir,
    port: u16,
    tools: PathBuf,
}

/// The folder of the server's programs: on the path, or where Debian puts them.
fn tools() -> PathBuf {
    let path = std::env::var_os("PATH").unwrap_or_default();
    let mut versions = Vec::new();
    if let Ok(entries) = std::fs::read_dir("/usr/lib/postgresql") {
        for entry in entries.flatten() {
            let version: Option<u32> =
                entry.file_name().to_str().and_then(|name| name.parse().ok());
            versions.extend(version);
        }
    }
    versions.sort_unstable();
    let newest_first = versions.into_iter().rev();
    let debian =
        newest_first.map(|version| PathBuf::from(format!("/usr/lib/postgresql/{version}/bin")));
    std::env::split_paths(&path)
        .chain(debian)
        .find(|folder| folder.join("initdb").exists() && folder.join("pg_ctl").exists())
        .expect("PostgreSQL's initdb is not installed: `make debian`")
}

impl Postgres {
    pub(crate) fn start() -> Self {
        let server = Self {
            folder: tempfile::Builder::new().prefix("hub-pg").tempdir().unwrap(),
            port: super::free_port(),
            tools: tools(),
        };
        if is_root() {
            let chown = Command::new("chown").arg("postgres").arg(server.folder.path()).status();
            assert!(chown.unwrap().success(), "chown to the user postgres");
        }
        let data = server.data();
        let options = [
            "-D",
            &data,
            "-A",
            "trust",
            "-U",
            "hub",
            "-E",
            "UTF8",
            "--locale=C",
            "-N",
        ];
        let made = server.command("initdb", &options).status();
        assert!(made.unwrap().success(), "initdb");
        server.up();
        server
    }

    fn data(&self) -> String {
        self.folder.path().join("data").display().to_string()
    }

    /// Starts the server, with retries: after a kill its last processes may need a moment to exit.
    pub(crate) fn up(&self) {
        let options = format!(
            "-c listen_addresses=127.0.0.1 -c port={} -c unix_socket_directories= -c max_connections=50",
            self.port
        );
        let log = self.folder.path().join("log").display().to_string();
        let data = self.data();
        let start = [
            "-D", &data, "-l", &log, "-w", "-t", "60", "-o", &options, "start",
        ];
        let until = Instant::now() + Duration::from_secs(60);
        loop {
            let started = self.command("pg_ctl", &start).status().unwrap();
            if started.success() {
                return;
            }
            let said = std::fs::read_to_string(&log).unwrap_or_default();
            assert!(Instant::now() < until, "{said}");
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    /// Kills the server with SIGKILL: changes not yet in its log are lost.
    pub(crate) fn kill(&self) {
        let id = self.process_id();
        // Stopped first, it starts no child that would outlive it and keep its shared memory.
        self.signal("-STOP");
        let _ = Command::new("pkill").args(["-9", "-P", &id]).status();
        let killed = Command::new("kill").args(["-9", &id]).status().unwrap();
        assert!(killed.success(), "the server's process {id} is killed");
    }

    /// The id of the server's first process, which started the others.
    fn process_id(&self) -> String {
        let file = std::fs::read_to_string(format!("{}/postmaster.pid", self.data())).unwrap();
        file.lines().next().unwrap().to_owned()
    }

    /// Sends a signal to every process of the server: `-STOP` freezes it, `-CONT` lets it go on.
    pub(crate) fn signal(&self, signal: &str) {
        let id = self.process_id();
        let parent = Command::new("kill").args([signal, id.as_str()]).status();
        assert!(parent.unwrap().success(), "the server's process {id} runs");
        let children = Command::new("pkill").args([signal, "-P", &id]).status();
        assert!(children.unwrap().success(), "the server has processes");
    }

    pub(crate) fn url(&self) -> String {
        format!("postgres://hub@127.0.0.1:{}/postgres", self.port)
    }

    /// A command of one of the server's programs, under the server's user.
    fn command(&self, program: &str, arguments: &[&str]) -> Command {
        let program = self.tools.join(program);
        let mut command = if is_root() {
            let mut command = Command::new("runuser");
            command.args(["-u", "postgres", "--"]).arg(&program);
            command
        } else {
            Command::new(&program)
        };
        command
            .args(arguments)
            .current_dir(self.folder.path())
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null());
        command
    }
}

impl Drop for Postgres {
    fn drop(&mut self) {
        let data = self.data();
        let stop = ["-D", data.as_str(), "-m", "immediate", "stop"];
        let _ = self.command("pg_ctl", &stop).status();
    }
}

fn is_root() -> bool {
    let id = Command::new("id").arg("-u").output().unwrap();
    id.stdout.trim_ascii() == b"0"
}
