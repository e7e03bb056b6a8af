//! A PostgreSQL server of its own: in a temporary folder, on loopback, by a user that is not root.

use std::path::PathBuf;
use std::process::{Command, Stdio};

/// A running server; stopped when dropped.
pub struct Postgres {
    folder: tempfile::TempDir,
    port: u16,
    tools: PathBuf,
}

/// Where the server's programs are: on the path, or where Debian puts them.
fn tools() -> PathBuf {
    let found = std::env::var_os("PATH")
        .into_iter()
        .flat_map(|path| std::env::split_paths(&path).collect::<Vec<_>>())
        .find(|folder| folder.join("initdb").exists() && folder.join("pg_ctl").exists());
    found
        .or_else(|| {
            let mut versions: Vec<_> = std::fs::read_dir("/usr/lib/postgresql")
                .ok()?
                .filter_map(|entry| Some(entry.ok()?.path().join("bin")))
                .filter(|folder| folder.join("initdb").exists())
                .collect();
            versions.sort();
            versions.pop()
        })
        .expect("PostgreSQL's initdb is not installed: `make debian`")
}

impl Postgres {
    /// Makes a new server and starts it.
    pub fn start() -> Self {
        let server = Self {
            folder: tempfile::Builder::new().prefix("hub-pg").tempdir().unwrap(),
            port: super::free_port(),
            tools: tools(),
        };
        if is_root() {
            let owner = Command::new("chown")
                .arg("postgres")
                .arg(server.folder.path())
                .status();
            assert!(
                owner.unwrap().success(),
                "the folder is given to the user postgres"
            );
        }
        let data = server.data();
        server.run(
            "initdb",
            &[
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
            ],
        );
        server.up();
        server
    }

    fn data(&self) -> String {
        self.folder.path().join("data").display().to_string()
    }

    /// Starts the server.
    pub fn up(&self) {
        let options = format!(
            "-c listen_addresses=127.0.0.1 -c port={} -c unix_socket_directories= -c max_connections=50",
            self.port
        );
        let log = self.folder.path().join("log").display().to_string();
        self.run(
            "pg_ctl",
            &[
                "-D",
                &self.data(),
                "-l",
                &log,
                "-w",
                "-t",
                "60",
                "-o",
                &options,
                "start",
            ],
        );
    }

    /// Stops it at once, as a crash would: what was not written to its log is gone.
    pub fn kill(&self) {
        self.run(
            "pg_ctl",
            &[
                "-D",
                &self.data(),
                "-w",
                "-t",
                "60",
                "-m",
                "immediate",
                "stop",
            ],
        );
    }

    /// Where it is.
    pub fn url(&self) -> String {
        format!("postgres://hub@127.0.0.1:{}/postgres", self.port)
    }

    fn run(&self, program: &str, arguments: &[&str]) {
        let program = self.tools.join(program);
        let mut command = if is_root() {
            let mut command = Command::new("runuser");
            command.args(["-u", "postgres", "--"]).arg(&program);
            command
        } else {
            Command::new(&program)
        };
        let status = command
            .args(arguments)
            .current_dir(self.folder.path())
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .status()
            .unwrap();
        assert!(
            status.success(),
            "{} {arguments:?}: {status}",
            program.display()
        );
    }
}

impl Drop for Postgres {
    fn drop(&mut self) {
        let program = self.tools.join("pg_ctl");
        let data = self.data();
        let arguments = ["-D", data.as_str(), "-m", "immediate", "stop"];
        let mut command = if is_root() {
            let mut command = Command::new("runuser");
            command.args(["-u", "postgres", "--"]).arg(program);
            command
        } else {
            Command::new(program)
        };
        let _ = command
            .args(arguments)
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .status();
    }
}

fn is_root() -> bool {
    let id = Command::new("id").arg("-u").output().unwrap();
    id.stdout.trim_ascii() == b"0"
}
