//! One file out of several: a tar archive (POSIX ustar), which every system can open. It is made in memory and holds
//! the state of a service, a megabyte or two.

const BLOCK: usize = 512;

/// The archive of these files, named and in order, all of the time `at_s` (seconds since the Unix epoch). A name may have
/// 100 bytes; a longer one is cut.
pub fn tar(files: &[(&str, Vec<u8>)], at_s: u64) -> Vec<u8> {
    let mut archive = Vec::new();
    for (name, content) in files {
        archive.extend_from_slice(&header(name, content.len(), at_s));
        archive.extend_from_slice(content);
        archive.resize(archive.len().next_multiple_of(BLOCK), 0);
    }
    // Two empty blocks are the end.
    archive.resize(archive.len() + 2 * BLOCK, 0);
    archive
}

fn header(name: &str, size: usize, at_s: u64) -> [u8; BLOCK] {
    let mut block = [0; BLOCK];
    let mut put = |from: usize, bytes: &[u8]| {
        for (place, byte) in block.iter_mut().skip(from).zip(bytes) {
            *place = *byte;
        }
    };
    put(0, &name.as_bytes()[..name.len().min(100)]);
    put(100, b"0000600\0");
    put(108, b"0000000\0");
    put(116, b"0000000\0");
    put(124, format!("{size:011o}\0").as_bytes());
    put(136, format!("{at_s:011o}\0").as_bytes());
    // The sum is made with blanks in its own place.
    put(148, b"        ");
    put(156, b"0");
    put(257, b"ustar\x0000");
    let sum: u32 = block.iter().map(|byte| u32::from(*byte)).sum();
    for (place, byte) in block
        .iter_mut()
        .skip(148)
        .zip(format!("{sum:06o}\0 ").as_bytes())
    {
        *place = *byte;
    }
    block
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;
    use std::process::{Command, Stdio};

    #[test]
    fn the_systems_own_tar_reads_the_archive() {
        let long = vec![b'x'; 1000];
        let archive = tar(
            &[
                ("a.json", b"{}".to_vec()),
                ("log.txt", long.clone()),
                ("empty", Vec::new()),
            ],
            1_790_000_000,
        );
        let folder = tempfile::tempdir().unwrap();
        let mut program = Command::new("tar")
            .args(["-x", "-f", "-", "-C"])
            .arg(folder.path())
            .stdin(Stdio::piped())
            .spawn()
            .unwrap();
        program.stdin.take().unwrap().write_all(&archive).unwrap();
        assert!(program.wait().unwrap().success());
        for (name, content) in [
            ("a.json", b"{}".to_vec()),
            ("log.txt", long),
            ("empty", Vec::new()),
        ] {
            assert_eq!(
                std::fs::read(folder.path().join(name)).unwrap(),
                content,
                "{name}"
            );
        }
    }
}
