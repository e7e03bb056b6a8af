//! Finds the pictures of a tar archive; each folder in it is a clip.

use super::source::{clip_name, folder_name, plain_name, unused_name};
use crate::error::EvalError;
use albireo_vision::picture::{
    EncodedPicture, FrameLimits, is_picture_file, natural_key, picture_of_file,
};
use std::collections::{HashMap, HashSet};
use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// An archive that is open for reading.
#[derive(Debug)]
struct Archive {
    path: PathBuf,
    file: File,
}

/// A picture in an archive.
#[derive(Clone, Debug)]
pub(super) struct ArchivedPicture {
    archive: Arc<Archive>,
    /// Its path in the archive.
    inside: PathBuf,
    offset: u64,
    length: usize,
}

impl ArchivedPicture {
    /// The archive, and the picture's path in it.
    pub(super) fn name(&self) -> String {
        let archive = self.archive.path.display();
        format!("{archive}: {}", self.inside.display())
    }

    /// Its path in the archive.
    pub(super) fn inside(&self) -> &Path {
        &self.inside
    }

    /// The bytes of the encoded picture.
    pub(super) fn bytes(&self) -> u64 {
        self.length as u64
    }

    /// Reads the picture.
    pub(super) fn read(&self) -> Result<EncodedPicture, EvalError> {
        let named =
            |fault: &dyn std::fmt::Display| EvalError::new(format!("{}: {fault}", self.name()));
        let mut bytes = vec![0; self.length];
        let file = &self.archive.file;
        file.read_exact_at(&mut bytes, self.offset).map_err(|error| named(&error))?;
        picture_of_file(bytes.into(), &FrameLimits::default())
            .map_err(|fault| named(&format!("not a picture that can be sent: {fault}")))
    }
}

/// A clip of an archive.
pub(super) struct ArchivedClip {
    pub name: String,
    /// In natural order, like those of a folder: tar stores files as the disk lists them, which is any order.
    pub pictures: Vec<ArchivedPicture>,
}

/// What is in an archive.
pub(super) struct ArchiveContent {
    pub clips: Vec<ArchivedClip>,
    /// That the archive is cut short or may be, in words.
    pub damage: Option<String>,
}

/// The folders of an archive.
struct Folders {
    folders: Vec<Folder>,
    end: ArchiveEnd,
}

/// How an archive ends.
#[derive(Clone, Copy, PartialEq, Eq)]
enum ArchiveEnd {
    /// With the mark that no member follows.
    Marked,
    /// Behind a whole member: some programs write no mark.
    Unmarked,
    /// Within a member.
    Cut,
}

/// A folder of an archive, with the pictures that lie in it itself.
struct Folder {
    path: PathBuf,
    pictures: Vec<ArchivedPicture>,
}

/// The length of what an archive is made of. One of zeros ends it.
const BLOCK: usize = 512;

/// Lists the JPEG and PNG files of an archive by their folders, in the order in which these first occur. Of one that is
/// cut short these are the files that are whole.
///
/// # Errors
/// When the archive cannot be read or has no pictures.
pub(super) fn archived_clips(path: &Path) -> Result<ArchiveContent, EvalError> {
    let Folders { folders, end } = folders_of(path)?;
    if folders.is_empty() {
        let what = if end == ArchiveEnd::Cut {
            "it is cut short, and no JPEG or PNG file in it is whole"
        } else {
            "it has no JPEG or PNG files"
        };
        return Err(EvalError::content(path, what));
    }
    let whole: usize = folders.iter().map(|folder| folder.pictures.len()).sum();
    let said = match end {
        ArchiveEnd::Marked => None,
        ArchiveEnd::Unmarked => Some(format!(
            "the archive has no end mark: if it was cut short, it was behind these {whole} pictures"
        )),
        ArchiveEnd::Cut => Some(format!(
            "the archive is cut short: {whole} pictures are whole"
        )),
    };
    let names = clip_names(&folders, &clip_name(path));
    let mut clips = Vec::new();
    for (name, folder) in names.into_iter().zip(folders) {
        let mut pictures = folder.pictures;
        pictures.sort_by_cached_key(|picture| natural_key(&picture.inside));
        clips.push(ArchivedClip { name, pictures });
    }
    Ok(ArchiveContent {
        clips,
        damage: said.map(|said| format!("{}: {said}", path.display())),
    })
}

/// True if no block of zeros is at the end.
fn lacks_end(file: &File, length: u64) -> std::io::Result<bool> {
    let Some(last) = length.checked_sub(BLOCK as u64) else {
        return Ok(true);
    };
    let mut block = [0; BLOCK];
    file.read_exact_at(&mut block, last)?;
    Ok(block.iter().any(|byte| *byte != 0))
}

/// Walks through the archive. A folder's pictures need not follow each other in it: tar writes them as the disk lists
/// them.
fn folders_of(path: &Path) -> Result<Folders, EvalError> {
    // It quotes what is no archive.
    let unreadable = |error: std::io::Error| {
        let said = error.to_string();
        EvalError::content(
            path,
            format!(
                "it cannot be read as a tar archive: {}",
                said.escape_debug()
            ),
        )
    };
    let file = File::open(path).map_err(unreadable)?;
    let file_length = file.metadata().map_err(unreadable)?.len();
    let archive = Arc::new(Archive {
        path: path.to_path_buf(),
        file,
    });
    let mut end = ArchiveEnd::Marked;
    // Where the last member ends.
    let mut members_end = 0;
    let mut folders: Vec<Folder> = Vec::new();
    let mut places: HashMap<PathBuf, usize> = HashMap::new();
    let mut members = tar::Archive::new(&archive.file);
    for member in members.entries_with_seek().map_err(unreadable)? {
        let member = match member {
            Ok(member) => member,
            Err(error) => {
                let is_at_end = lacks_end(&archive.file, file_length).map_err(unreadable)?;
                if folders.is_empty() || !is_at_end {
                    return Err(unreadable(error));
                }
                end = ArchiveEnd::Cut;
                break;
            }
        };
        let offset = member.raw_file_position();
        // One with holes is longer than what is stored of it.
        if !member.header().entry_type().is_gnu_sparse() {
            members_end = offset.saturating_add(member.size());
        }
        if members_end > file_length {
            end = ArchiveEnd::Cut;
            continue;
        }
        let inside = member.path().map_err(unreadable)?;
        if !member.header().entry_type().is_file() || !is_picture_file(&inside) {
            continue;
        }
        let length = usize::try_from(member.size()).unwrap_or(usize::MAX);
        if length > FrameLimits::default().max_payload_bytes {
            let what = format!("{} is too large for a picture", inside.display());
            return Err(EvalError::content(path, what));
        }
        let folder = inside.parent().unwrap_or(Path::new(""));
        let place = *places.entry(folder.to_owned()).or_insert(folders.len());
        if place == folders.len() {
            folders.push(Folder {
                path: folder.to_owned(),
                pictures: Vec::new(),
            });
        }
        folders[place].pictures.push(ArchivedPicture {
            archive: Arc::clone(&archive),
            inside: inside.to_path_buf(),
            offset,
            length,
        });
    }
    let ends_with_file = || members_end.next_multiple_of(BLOCK as u64) >= file_length;
    if end == ArchiveEnd::Marked && ends_with_file() {
        end = ArchiveEnd::Unmarked;
    }
    Ok(Folders { folders, end })
}

/// Names the clips of an archive after its folders. Folders of one name in different places are told apart by the
/// folders around them, joined as in the names that COCO's files give their clips. Pictures in no folder have the name
/// of the archive.
fn clip_names(folders: &[Folder], archive: &str) -> Vec<String> {
    let own_name = |folder: &Folder| match folder.path.file_name() {
        Some(_) => folder_name(&folder.path),
        None => archive.to_owned(),
    };
    let mut folders_by_name: HashMap<String, usize> = HashMap::new();
    for folder in folders {
        *folders_by_name.entry(own_name(folder)).or_default() += 1;
    }
    let mut names: Vec<String> = Vec::new();
    let mut taken: HashSet<String> = HashSet::new();
    for folder in folders {
        let own = own_name(folder);
        let is_ambiguous = folders_by_name[&own] > 1 && folder.path.file_name().is_some();
        let wanted = if is_ambiguous {
            let whole_path = folder.path.to_string_lossy().replace('/', "-");
            plain_name(whole_path.trim_start_matches(['.', '-']))
        } else {
            own
        };
        // Even whole paths can be the same once they are shortened and have no letters beyond ASCII.
        let name = unused_name(&wanted, |name| taken.contains(name));
        taken.insert(name.clone());
        names.push(name);
    }
    names
}
