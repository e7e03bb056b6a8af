use super::*;
use std::fs;
use std::process::Command;

/// A folder with empty files of these names.
fn folder(names: &[&str]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for name in names {
        fs::write(folder.path().join(name), "").unwrap();
    }
    folder
}

fn listed_in(folder: &tempfile::TempDir) -> Result<Vec<String>, String> {
    let files = video_files(folder.path().to_str().unwrap())?;
    Ok(files
        .iter()
        .map(|file| file.file_name().unwrap().to_str().unwrap().to_owned())
        .collect())
}

#[test]
fn minutes_and_chapters_are_in_the_order_in_which_they_were_recorded() {
    for names in [
        // 70mai: the number of the file begins again, the time does not.
        &[
            "NO20261120-235959-000999F.MP4",
            "NO20261121-000059-000001F.MP4",
        ][..],
        // Viofo, today and before.
        &[
            "2026_1120_080001_F.MP4",
            "2026_1120_080101_F.MP4",
            "2026_1121_070001_PF.MP4",
        ],
        &["20261120_080001_0009F.MP4", "20261120_080101_0010F.MP4"],
        // BlackVue: an event lies between the minutes.
        &[
            "20261120_080001_NF.mp4",
            "20261120_080101_EF.mp4",
            "20261120_080201_NF.mp4",
        ],
        &[
            "2026-11-20_08-00-01-front.mp4",
            "2026-11-20_08-01-01-front.mp4",
        ],
        // Nextbase: the year has two digits.
        &[
            "231231_235959_002_FH.MP4",
            "240101_000059_001_FH.MP4",
            "FILE240101-000159F.MP4",
        ],
        // GoPro: all chapters of a recording before the next recording.
        &[
            "GX010123.MP4",
            "GX020123.MP4",
            "GX030123.MP4",
            "GX010124.MP4",
            "GX020124.MP4",
        ],
        &[
            "GOPR0123.MP4",
            "GP010123.MP4",
            "GP020123.MP4",
            "GOPR0124.MP4",
        ],
        &["clip2.mp4", "clip10.mp4", "clip11.mov"],
    ] {
        let mut shuffled = names.to_vec();
        shuffled.reverse();
        shuffled.extend(["._clip.mp4", "GX010123.THM", "notes.txt"]);
        assert_eq!(listed_in(&folder(&shuffled)).unwrap(), names);
    }
}

#[test]
fn files_of_several_cameras_are_not_mixed_and_a_pattern_chooses() {
    for (names, said, mark) in [
        (
            ["2026_1120_080001_F.MP4", "2026_1120_080001_R.MP4"],
            "1 front (2026_1120_080001_F.MP4), 1 rear (2026_1120_080001_R.MP4)",
            "*F.MP4",
        ),
        (
            ["20261120_080001_NF.mp4", "20261120_080001_NI.mp4"],
            "1 front (",
            "*NF.mp4",
        ),
        (
            ["20261120_080001_NF.mp4", "20261120_080001_NFS.mp4"],
            "front (small copy) (",
            "*NF.mp4",
        ),
        (
            [
                "NO20261120-080001-000001F.MP4",
                "NO20261120-080001-000001B.MP4",
            ],
            "1 rear (",
            "*F.MP4",
        ),
        (
            ["240131_235959_001_FH.MP4", "240131_235959_001_RH.MP4"],
            "1 front (240131_235959_001_FH.MP4), 1 rear (",
            "*FH.MP4",
        ),
        (
            ["FILE240131-235959F.MP4", "FILE240131-235959R.MP4"],
            "1 front (",
            "*F.MP4",
        ),
        (
            ["FILE0001F.MP4", "FILE0001R.MP4"],
            "1 front (FILE0001F.MP4), 1 rear (FILE0001R.MP4)",
            "*F.MP4",
        ),
        (
            ["drive_front.mp4", "drive_rear.mp4"],
            "1 front (drive_front.mp4)",
            "*front.mp4",
        ),
        (
            ["2026_1120_080001_R.MP4", "holiday.mp4"],
            "1 other (holiday.mp4)",
            "*R.MP4",
        ),
    ] {
        let folder = folder(&names);
        let refused = listed_in(&folder).unwrap_err();
        let path = folder.path().join(mark);
        let pattern = path.to_str().unwrap();
        for part in [said, pattern, "several cameras"] {
            assert!(refused.contains(part), "{part}: {refused}");
        }
        assert!(are_several(pattern));
        let in_small_letters = folder.path().join(mark.to_lowercase());
        let chosen = video_files(in_small_letters.to_str().unwrap()).unwrap();
        assert_eq!(chosen.len(), 1, "{pattern}");
    }
}

#[test]
fn a_letter_is_a_mark_only_behind_a_time_and_a_word_only_if_it_is_one() {
    let folder = folder(&["plan_b.mp4", "plan_f.mp4", "waterfront.mp4"]);
    assert_eq!(listed_in(&folder).unwrap().len(), 3);
}

#[test]
fn names_that_count_with_letters_are_of_one_camera() {
    let folder = folder(&["scene1a.mp4", "scene1b.mp4", "scene1f.mp4", "scene2f.mp4"]);
    assert_eq!(listed_in(&folder).unwrap().len(), 4);
}

#[test]
fn a_folder_without_videos_says_where_there_are_some() {
    let folder = folder(&["notes.txt"]);
    let below = folder.path().join("Movie");
    fs::create_dir(&below).unwrap();
    let none = listed_in(&folder).unwrap_err();
    assert!(none.ends_with("no video files in it"), "{none}");
    fs::write(below.join("a.MP4"), "").unwrap();
    let some = listed_in(&folder).unwrap_err();
    assert!(some.contains(below.to_str().unwrap()), "{some}");
}

#[test]
fn a_pattern_names_files_in_folders_below() {
    let folder = folder(&["notes.txt"]);
    let below = folder.path().join("Movie");
    fs::create_dir(&below).unwrap();
    fs::write(below.join("a.MP4"), "").unwrap();
    let pattern = format!("{}/*/*.mp4", folder.path().display());
    assert_eq!(video_files(&pattern).unwrap(), [below.join("a.MP4")]);
}

#[test]
fn a_pattern_that_matches_no_video_file_is_an_error() {
    let folder = folder(&["notes.txt"]);
    let pattern = format!("{}/*.avi", folder.path().display());
    let error = video_files(&pattern).unwrap_err();
    assert!(error.contains("no video file has such a name"), "{error}");
}

/// Makes a video of so many seconds.
fn film(path: &Path, seconds: u32, more: &[&str]) {
    let input = format!("testsrc2=size=64x36:rate=10:duration={seconds}");
    let made = Command::new("ffmpeg")
        .args([
            "-v", "error", "-f", "lavfi", "-i", &input, "-c:v", "libx264", "-g", "10",
        ])
        .args(more)
        .arg(path)
        .status();
    assert!(made.unwrap().success(), "{path:?}");
}

fn cut(path: &Path, share: f64) {
    let bytes = fs::read(path).unwrap();
    fs::write(path, &bytes[..(bytes.len() as f64 * share) as usize]).unwrap();
}

/// What is told of a file that can be played.
#[derive(Debug, PartialEq)]
struct Told {
    drive: String,
    begins_drive: bool,
    /// Seconds since the Unix epoch.
    started_s: Option<u64>,
}

/// For each file its name, and what is told of it, or why it is passed over.
fn played(folder: &Path) -> Vec<(String, Result<Told, String>)> {
    let files = video_files(folder.to_str().unwrap()).unwrap();
    let name = |path: &Path| path.file_name().unwrap().to_str().unwrap().to_owned();
    let mut played = Vec::new();
    for file in Drives::new(files, "ffprobe".into()) {
        match file {
            Ok(recording) => {
                let told = Told {
                    drive: recording.drive.to_string(),
                    begins_drive: recording.begins_drive,
                    started_s: recording.started_ns.map(|started| started / 1_000_000_000),
                };
                played.push((name(&recording.path), Ok(told)));
            }
            Err(passed_over) => played.push((name(&passed_over.path), Err(passed_over.reason))),
        }
    }
    played
}

#[test]
#[ignore = "needs ffmpeg"]
fn files_without_a_gap_are_a_drive_and_what_a_power_cut_left_is_passed_over() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    for time in [
        "080000", "080003", "080005", "080100", "080103", "080106", "080109",
    ] {
        film(&at(&format!("2026_1120_{time}_F.MP4")), 3, &[]);
    }
    cut(&at("2026_1120_080103_F.MP4"), 0.6);
    fs::write(at("2026_1120_080106_F.MP4"), "").unwrap();
    film(
        &at("2026_1120_080120_F.MP4"),
        3,
        &["-movflags", "faststart"],
    );
    cut(&at("2026_1120_080120_F.MP4"), 0.7);
    let fragments = ["-movflags", "frag_keyframe+empty_moov"];
    film(&at("2026_1120_080200_F.MP4"), 3, &fragments);
    cut(&at("2026_1120_080200_F.MP4"), 0.7);
    film(&at("2026_1120_080300_F.MP4"), 1, &[]);

    let played = played(folder.path());
    let expected = [
        ("080000", Ok("080000")),
        ("080003", Ok("080000")),
        ("080005", Ok("080000")),
        ("080100", Ok("080100")),
        ("080103", Err("no index")),
        ("080106", Err("it is empty")),
        ("080109", Ok("080109")),
        ("080120", Err("it is cut short")),
        ("080200", Ok("080200")),
        ("080300", Ok("080300")),
    ];
    assert_eq!(played.len(), expected.len());
    for ((name, told), (time, expected)) in played.iter().zip(expected) {
        assert_eq!(*name, format!("2026_1120_{time}_F.MP4"));
        match (told, expected) {
            (Ok(told), Ok(drive)) => {
                assert_eq!(told.drive, format!("2026_1120_{drive}_F"));
                assert_eq!(told.begins_drive, drive == time);
            }
            (Err(reason), Err(said)) => assert!(reason.contains(said), "{reason}"),
            _ => panic!("{name}: {told:?}, not {expected:?}"),
        }
    }
    // In the time zone of this machine: a minute between the two drives.
    let started_s = |time: &str| {
        let file = format!("2026_1120_{time}_F.MP4");
        let (_, told) = played.iter().find(|(name, _)| *name == file).unwrap();
        told.as_ref().unwrap().started_s.unwrap()
    };
    assert_eq!(started_s("080100") - started_s("080000"), 60);
}

#[test]
#[ignore = "needs ffmpeg"]
fn an_index_that_reaches_to_the_end_of_the_file_is_one() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mp4");
    film(&path, 1, &[]);
    let mut bytes = fs::read(&path).unwrap();
    let kind = bytes.windows(4).rposition(|bytes| bytes == b"moov").unwrap();
    // ISO 14496-12, 4.2: the last box may say 0 in place of its size.
    bytes[kind - 4..kind].fill(0);
    fs::write(&path, bytes).unwrap();
    let played = played(folder.path());
    let [(_, told)] = played.as_slice() else {
        panic!("not one file: {played:?}");
    };
    assert!(told.is_ok(), "{told:?}");
}

/// Why the only file of a folder is passed over; `None` if it is played.
fn passed_over(folder: &tempfile::TempDir) -> Option<String> {
    let played = played(folder.path());
    assert_eq!(played.len(), 1, "{played:?}");
    played.into_iter().find_map(|(_, told)| told.err())
}

/// A file whose index comes first, and the place at which its pictures begin.
fn film_with_index_first(folder: &tempfile::TempDir) -> (PathBuf, usize) {
    let path = folder.path().join("a.mp4");
    film(&path, 1, &["-movflags", "faststart"]);
    let bytes = fs::read(&path).unwrap();
    let kind = bytes.windows(4).rposition(|bytes| bytes == b"mdat").unwrap();
    (path, kind - 4)
}

#[test]
#[ignore = "needs ffmpeg"]
fn a_file_cut_before_its_pictures_is_passed_over() {
    let folder = tempfile::tempdir().unwrap();
    let (path, pictures) = film_with_index_first(&folder);
    let bytes = fs::read(&path).unwrap();
    // At the box of the pictures, and within its size and its name.
    for end in [pictures, pictures + 3, pictures + 7] {
        fs::write(&path, &bytes[..end]).unwrap();
        let reason = passed_over(&folder).unwrap();
        assert!(reason.contains("cut short"), "{end}: {reason}");
    }
}

#[test]
#[ignore = "needs ffmpeg"]
fn bytes_behind_the_pictures_are_in_nobodys_way() {
    let folder = tempfile::tempdir().unwrap();
    let (path, _) = film_with_index_first(&folder);
    let mut bytes = fs::read(&path).unwrap();
    bytes.extend(b"END OF RECORDING, says the camera");
    fs::write(&path, bytes).unwrap();
    assert_eq!(passed_over(&folder), None);
}

#[test]
#[ignore = "needs ffmpeg"]
fn a_name_that_looks_like_an_option_or_an_address_is_a_files() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["-i.mp4", "12:30.mp4"] {
        film(&folder.path().join(name), 1, &[]);
        let relative = for_ffmpeg(Path::new(name));
        let mut ffprobe = Command::new("ffprobe");
        ffprobe.args(["-v", "error"]).arg(relative).current_dir(folder.path());
        assert!(ffprobe.status().unwrap().success(), "{name}");
    }
    assert_eq!(
        for_ffmpeg(Path::new("a/12:30.mp4")),
        Path::new("a/12:30.mp4")
    );
    assert_eq!(for_ffmpeg(Path::new("/a:b/1.mp4")), Path::new("/a:b/1.mp4"));
}

#[test]
#[ignore = "needs ffmpeg"]
fn times_come_from_the_file_where_its_name_has_none_and_chapters_follow_each_other() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    // GoPro stamps all chapters with the time of the recording.
    let first = ["-metadata", "creation_time=2026-11-20T08:00:00Z"];
    let second = ["-metadata", "creation_time=2026-11-20T09:00:00Z"];
    film(&at("GX010123.MP4"), 3, &first);
    film(&at("GX020123.MP4"), 3, &first);
    film(&at("GX010124.MP4"), 2, &second);
    let eight = 1_795_161_600;
    let played_as = |name: &str, drive: &str, started_s: u64| {
        let told = Told {
            drive: drive.to_owned(),
            begins_drive: name.starts_with(drive),
            started_s: Some(started_s),
        };
        (name.to_owned(), Ok(told))
    };
    let expected = [
        played_as("GX010123.MP4", "GX010123", eight),
        played_as("GX020123.MP4", "GX010123", eight + 3),
        played_as("GX010124.MP4", "GX010124", eight + 3600),
    ];
    assert_eq!(played(folder.path()), expected);
}

#[test]
#[ignore = "needs ffmpeg"]
fn without_any_time_only_a_hole_ends_a_drive() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["a1.mkv", "a2.mkv", "a3.mkv", "a4.mkv"] {
        film(&folder.path().join(name), 1, &[]);
    }
    fs::write(folder.path().join("a3.mkv"), "no video").unwrap();
    let played = played(folder.path());
    let drives: Vec<_> = played
        .iter()
        .map(|(_, told)| told.as_ref().ok().map(|told| told.drive.as_str()))
        .collect();
    assert_eq!(drives, [Some("a1"), Some("a1"), None, Some("a4")]);
}

#[test]
fn a_frame_rate_is_a_valid_fraction() {
    assert_eq!(frame_rate("25/1"), Some(25.0));
    assert_eq!(frame_rate("30000/1001"), Some(30000.0 / 1001.0));
    for text in ["0/0", "90000/1", "x", "-5/1", ""] {
        assert_eq!(frame_rate(text), None, "{text}");
    }
}
