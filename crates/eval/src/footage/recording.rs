//! Reads the pictures of an MCAP file: a recording of a node, of Foxglove, or of ROS 2.

use super::pace::{Jumps, Pace};
use super::pictures::Pictures;
use super::source::{FrameSource, clip_name, plain_name};
use crate::error::EvalError;
use albireo_recording::{
    Channel, Message, Messages, Overview, PictureKind, RecordingError, Topic, picture_in_json,
    picture_in_protobuf,
};
use albireo_vision::picture::{EncodedPicture, FrameLimits, picture_of_file, ros2};
use bytes::Bytes;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// The kinds of pictures that are read, for errors.
const READABLE: &str = "foxglove.CompressedImage in protobuf or JSON, and ROS 2 sensor_msgs/msg/CompressedImage and Image in \
                        CDR are read";

/// The number of pictures whose times give the rate: enough, and soon read.
const TIMED: usize = 500;

/// The pictures on one topic of a file.
pub(super) struct Recording {
    path: PathBuf,
    topic: String,
    name: String,
    rate: f64,
    /// How the pictures follow each other by their times, if they have some.
    pace: Option<Pace>,
    /// Where the times of this pass jump, if they follow each other somehow.
    times: Option<Jumps>,
    frames: u64,
    messages: Messages,
    /// The number of the last picture, from 1.
    number: u64,
    /// How often the times of this pass have jumped.
    jumps: u64,
    /// The clip that began at the last jump.
    clip: Option<String>,
    /// True if the file ends early, which was told when it was opened.
    is_cut: bool,
    /// True once the end was reached.
    is_over: bool,
}

/// A topic with pictures.
struct PictureTopic {
    name: String,
    pictures: u64,
}

/// What is in a file.
struct Contents {
    overview: Overview,
    topics: Vec<PictureTopic>,
}

impl Contents {
    fn read(path: &Path) -> Result<Self, EvalError> {
        let overview = Overview::read(path).map_err(|error| {
            EvalError::content(path, format!("it cannot be read as an MCAP file: {error}"))
        })?;
        // A topic may have several channels: each of its senders has one, and so has each of the files that were joined.
        let mut pictures: BTreeMap<&str, u64> = BTreeMap::new();
        for (channel, count) in &overview.channels {
            if *count > 0 && PictureKind::of(channel).is_some() {
                *pictures.entry(&channel.topic).or_default() += count;
            }
        }
        let mut topics = Vec::new();
        let mut audited = Vec::new();
        for (name, count) in pictures {
            let topic = PictureTopic {
                name: name.to_owned(),
                pictures: count,
            };
            match Topic::parse(name) {
                Some((_, Topic::AuditImage)) => audited.push(topic),
                _ => topics.push(topic),
            }
        }
        // Pictures of the audit are no sequence: they are read if there is nothing else.
        if topics.is_empty() {
            topics = audited;
        }
        if topics.is_empty() {
            let what = format!(
                "it has no pictures: {READABLE}; it has {}",
                listed(&overview)
            );
            return Err(EvalError::content(path, what));
        }
        Ok(Self { overview, topics })
    }
}

/// The topics of a file with their types, for an error.
fn listed(overview: &Overview) -> String {
    let one = |(channel, count): &(std::sync::Arc<Channel>, u64)| {
        let Channel {
            topic,
            schema,
            encoding,
            ..
        } = &**channel;
        format!("{topic} ({schema} in {encoding}, {count} messages)")
    };
    match overview.channels.as_slice() {
        [] => "no messages".to_owned(),
        some => some.iter().map(one).collect::<Vec<_>>().join(", "),
    }
}

/// The error for a file with several topics of pictures, of which none was named.
fn no_topic_named(path: &Path, topics: &[PictureTopic]) -> EvalError {
    let names: Vec<&str> = topics.iter().map(|topic| topic.name.as_str()).collect();
    let what = format!(
        "it has pictures on several topics: name one, {}:{}; the others are {}",
        path.display(),
        names[0],
        names[1..].join(", ")
    );
    EvalError::content(path, what)
}

impl Recording {
    /// The topics with pictures, in their order.
    ///
    /// # Errors
    /// When the file cannot be read or has no pictures.
    pub(super) fn topics(path: &Path) -> Result<Vec<String>, EvalError> {
        let topics = Contents::read(path)?.topics;
        Ok(topics.into_iter().map(|topic| topic.name).collect())
    }

    /// The name of the pictures on `topic`, or on the only topic that has some.
    ///
    /// # Errors
    /// The same as for [`open`](Self::open).
    pub(super) fn name_of(path: &Path, topic: Option<&str>) -> Result<String, EvalError> {
        let contents = Contents::read(path)?;
        let found = chosen(path, topic, &contents)?;
        Ok(name_of_topic(path, found, &contents))
    }

    /// Opens the pictures on `topic`, or on the only topic that has some. `rate`: frames per second of pictures without
    /// times.
    ///
    /// # Errors
    /// When the file cannot be read, has no pictures, or has several topics with pictures and none is named.
    pub(super) fn open(
        path: &Path,
        topic: Option<&str>,
        rate: Option<f64>,
    ) -> Result<Self, EvalError> {
        let contents = Contents::read(path)?;
        let found = chosen(path, topic, &contents)?;
        let overview = &contents.overview;
        let frames = found.pictures;
        if let Some(damage) = &overview.damage {
            let file = path.display();
            eprintln!(
                "albireo: {file} ends early ({damage}); its {frames} whole pictures are used"
            );
        }
        let times: Vec<u64> = opened(path)?
            .filter(|message| has_picture_of(&found.name, message))
            .map(|message| message.time_ns)
            .take(TIMED)
            .collect();
        let pace = Pace::of(&times).filter(|pace| (0.01..=1000.0).contains(&pace.rate));
        let rate = match (pace, rate) {
            // As exact as such a clock, and as a person reads it.
            (Some(pace), _) => (pace.rate * 1e3).round() / 1e3,
            (None, Some(given)) => given,
            (None, None) => {
                if frames > 1 {
                    let file = path.display();
                    let assumed = Pictures::DEFAULT_RATE;
                    eprintln!(
                        "albireo: {file} has no times from which a rate follows: {assumed} pictures a second are assumed; \
                         --rate says how many there are"
                    );
                }
                Pictures::DEFAULT_RATE
            }
        };
        Ok(Self {
            messages: opened(path)?,
            path: path.to_owned(),
            name: name_of_topic(path, found, &contents),
            rate,
            pace,
            times: pace.map(Jumps::at),
            frames,
            topic: found.name.clone(),
            number: 0,
            jumps: 0,
            clip: None,
            is_cut: overview.damage.is_some(),
            is_over: false,
        })
    }

    fn read(&self, channel: &Channel, message: &Bytes) -> Result<EncodedPicture, EvalError> {
        let limits = FrameLimits::default();
        let named = |fault: &dyn std::fmt::Display| {
            EvalError::new(format!("{}: {fault}", self.last_name()))
        };
        let picture_in = |read: Result<Bytes, RecordingError>| {
            let file = read.map_err(|error| named(&error))?;
            picture_of_file(file, &limits).map_err(|fault| named(&fault))
        };
        match PictureKind::of(channel) {
            Some(PictureKind::FoxgloveProtobuf) => picture_in(picture_in_protobuf(message)),
            Some(PictureKind::FoxgloveJson) => picture_in(picture_in_json(message)),
            Some(PictureKind::Ros2) => ros2::read_message(message, &limits)
                .map(|(picture, _)| picture)
                .map_err(|fault| named(&fault)),
            None => Err(named(&READABLE)),
        }
    }

    /// The file, the topic and the number of the last picture, if there was one.
    fn last_name(&self) -> String {
        let Self {
            path,
            topic,
            number,
            ..
        } = self;
        match number {
            0 => format!("{}:{topic}", path.display()),
            _ => format!("{}:{topic}, picture {number}", path.display()),
        }
    }

    /// Notes when the next picture was recorded. A clip begins with it if the times jump.
    fn arrive(&mut self, time_ns: u64) {
        if let Some(times) = &mut self.times
            && times.arrive(time_ns)
        {
            self.jumps += 1;
            self.clip = Some(format!("{}-{}", self.name, self.jumps + 1));
        }
    }
}

/// The topic that is named, or the only one.
fn chosen<'a>(
    path: &Path,
    topic: Option<&str>,
    contents: &'a Contents,
) -> Result<&'a PictureTopic, EvalError> {
    let found = match (topic, contents.topics.as_slice()) {
        (Some(name), topics) => topics.iter().find(|topic| topic.name == name),
        (None, [only]) => Some(only),
        (None, several) => return Err(no_topic_named(path, several)),
    };
    found.ok_or_else(|| {
        let what = format!(
            "it has no pictures on this topic; it has {}",
            listed(&contents.overview)
        );
        EvalError::content(path, what)
    })
}

/// The name of the pictures on a topic: the file's, and that of the topic if there are several.
fn name_of_topic(path: &Path, topic: &PictureTopic, contents: &Contents) -> String {
    let file = clip_name(path);
    if contents.topics.len() > 1 {
        plain_name(&format!("{file}{}", topic.name.replace('/', "_")))
    } else {
        file
    }
}

/// True if the message is a picture on this topic.
fn has_picture_of(topic: &str, message: &Message) -> bool {
    message.channel.topic == topic && PictureKind::of(&message.channel).is_some()
}

fn opened(path: &Path) -> Result<Messages, EvalError> {
    Messages::open(path).map_err(|error| EvalError::content(path, error))
}

impl FrameSource for Recording {
    fn name(&self) -> &str {
        &self.name
    }

    fn picture_name(&self) -> Option<String> {
        Some(self.last_name())
    }

    fn clip(&self) -> Option<&str> {
        self.clip.as_deref()
    }

    fn remarks(&self) -> Vec<String> {
        if self.jumps == 0 {
            return Vec::new();
        }
        vec![format!(
            "{}: its times jump, {} in all; its pictures are taken at an even rate of {}/s",
            self.path.display(),
            self.jumps,
            self.rate
        )]
    }

    fn rate(&self) -> f64 {
        self.rate
    }

    fn frames(&self) -> Option<u64> {
        Some(self.frames)
    }

    fn next(&mut self) -> Result<Option<EncodedPicture>, EvalError> {
        if self.is_over {
            return Ok(None);
        }
        while let Some(message) = self.messages.next() {
            if has_picture_of(&self.topic, &message) {
                self.number += 1;
                self.arrive(message.time_ns);
                return self.read(&message.channel, &message.data).map(Some);
            }
        }
        self.is_over = true;
        match self.messages.damage() {
            Some(damage) if !self.is_cut => {
                let name = self.last_name();
                Err(EvalError::new(format!(
                    "{name}: the file is damaged, and nothing is read after this: {damage}"
                )))
            }
            _ => Ok(None),
        }
    }

    fn rewind(&mut self) -> Result<(), EvalError> {
        self.messages = opened(&self.path)?;
        self.number = 0;
        self.times = self.pace.map(Jumps::at);
        self.jumps = 0;
        self.clip = None;
        self.is_over = false;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use albireo_recording::{AuditMessage, RecordingFile};
    use albireo_wire::VERSION;

    /// A recording with pictures at these milliseconds.
    fn recorded(folder: &tempfile::TempDir, times_ms: &[u64]) -> PathBuf {
        let path = folder.path().join("drive.mcap");
        let mut picture = Vec::new();
        jpeg_encoder::Encoder::new(&mut picture, 90)
            .encode(&[90; 64], 8, 8, jpeg_encoder::ColorType::Luma)
            .unwrap();
        let mut file = RecordingFile::create(&path).unwrap();
        for (seq, ms) in (0..).zip(times_ms) {
            let audit = AuditMessage {
                v: VERSION,
                seq,
                t_ns: ms * 1_000_000,
                width: 8,
                height: 8,
                shown: Vec::new(),
                detected: Vec::new(),
            };
            file.audited("front", picture.clone().into(), &audit).unwrap();
        }
        file.finish().unwrap();
        path
    }

    #[test]
    fn a_clip_begins_where_the_times_of_a_recording_jump_and_the_jumps_are_told() {
        let folder = tempfile::tempdir().unwrap();
        let path = recorded(&folder, &[0, 100, 200, 90_000, 90_100, 50, 150]);
        let mut recording = Recording::open(&path, None, None).unwrap();
        assert_eq!(recording.rate(), 10.0);
        for _ in 0..2 {
            let mut clips = Vec::new();
            while recording.next().unwrap().is_some() {
                clips.push(recording.clip().unwrap_or(recording.name()).to_owned());
            }
            let expected = [
                "drive", "drive", "drive", "drive-2", "drive-2", "drive-3", "drive-3",
            ];
            assert_eq!(clips, expected);
            let remarks = recording.remarks();
            assert!(
                remarks[0].contains("its times jump, 2 in all"),
                "{remarks:?}"
            );
            recording.rewind().unwrap();
        }
        assert_eq!(recording.remarks(), [""; 0]);
    }

    #[test]
    fn a_recording_without_times_has_the_rate_that_is_given() {
        let folder = tempfile::tempdir().unwrap();
        let path = recorded(&folder, &[0, 0, 0]);
        for (given, rate) in [(None, Pictures::DEFAULT_RATE), (Some(4.0), 4.0)] {
            let recording = Recording::open(&path, None, given).unwrap();
            assert_eq!(recording.rate(), rate);
        }
    }
}
