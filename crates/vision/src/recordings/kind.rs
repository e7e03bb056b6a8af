//! Tells by a file's first bytes what it is, where ffmpeg would find a video in what is none: in a bag of two cameras one
//! stream of their pictures.

use std::fs::File;
use std::io::Read;
use std::path::Path;

/// A tar archive says what it is behind the name, the owner and the time of its first member.
const TAR_MARK: usize = 257;
/// As many bytes as the longest mark needs.
const LOOKED_AT: u64 = 262;

/// The first bytes of files that are packed.
const PACKED: [&[u8]; 6] = [
    b"\x1f\x8b",
    b"BZh",
    b"\xfd7zXZ\0",
    b"\x28\xb5\x2f\xfd",
    b"7z\xbc\xaf\x27\x1c",
    b"Rar!\x1a\x07",
];

/// What a file is that is neither a video nor a picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileKind {
    /// A recording.
    Mcap,
    /// An archive of files as they are.
    Tar,
    /// A bag of ROS 1.
    Rosbag,
    /// A database, as ROS 2 writes its bags.
    Database,
    /// An archive of compressed files.
    Zip,
    /// A compressed file.
    Packed,
}

impl FileKind {
    /// What a file is, whatever its name; `None` for any other file, and for what is no file or cannot be read.
    pub fn of(path: &Path) -> Option<Self> {
        // Whoever opens a pipe takes from it what it reads.
        if !path.is_file() {
            return None;
        }
        let mut first = Vec::new();
        File::open(path).ok()?.take(LOOKED_AT).read_to_end(&mut first).ok()?;
        let begins = |mark: &[u8]| first.starts_with(mark);
        if begins(b"\x89MCAP") {
            Some(Self::Mcap)
        } else if begins(b"#ROSBAG") {
            Some(Self::Rosbag)
        } else if begins(b"SQLite format 3\0") {
            Some(Self::Database)
        } else if begins(b"PK\x03\x04") {
            Some(Self::Zip)
        } else if PACKED.into_iter().any(begins) {
            Some(Self::Packed)
        } else if first.get(TAR_MARK..).is_some_and(|mark| mark.starts_with(b"ustar")) {
            Some(Self::Tar)
        } else {
            None
        }
    }

    /// What it is and what to do, if it is to be played as a video or as pictures.
    pub fn remedy(self) -> &'static str {
        match self {
            Self::Mcap => "it is an MCAP file, which `albireo replay` plays",
            Self::Tar => "it is a tar archive, of which `albireo replay` plays the pictures",
            Self::Rosbag => {
                "it is a ROS 1 bag: convert it to MCAP, with `rosbags-convert --src FILE --dst FOLDER --dst-storage mcap` \
                 (pip install rosbags), and name the .mcap file in FOLDER"
            }
            Self::Database => {
                "it is an SQLite database, as ROS 2 writes its bags: convert the bag to MCAP, with `rosbags-convert --src BAG \
                 --dst FOLDER --dst-storage mcap` (pip install rosbags) or `ros2 bag convert`, and name the .mcap file in it"
            }
            Self::Zip => "it is a zip archive: unpack it, and name what is in it",
            Self::Packed => "it is compressed: unpack it, and name what is in it",
        }
    }
}
