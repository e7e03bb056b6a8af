//! Reads the pictures of an MCAP file: a recording of a node, of Foxglove, or of ROS 2.

use super::pace::Pace;
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
    frames: u64,
    messages: Messages,
    /// The number of the last picture, from 1.
    number: u64,
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

    /// Opens the pictures on `topic`, or on the only topic that has some.
    ///
    /// # Errors
    /// When the file cannot be read, has no pictures, or has several topics with pictures and none is named.
    pub(super) fn open(path: &Path, topic: Option<&str>) -> Result<Self, EvalError> {
        let Contents { overview, topics } = Contents::read(path)?;
        let found = match (topic, topics.as_slice()) {
            (Some(name), topics) => topics.iter().find(|topic| topic.name == name),
            (None, [only]) => Some(only),
            (None, several) => return Err(no_topic_named(path, several)),
        };
        let Some(found) = found else {
            let what = format!(
                "it has no pictures on this topic; it has {}",
                listed(&overview)
            );
            return Err(EvalError::content(path, what));
        };
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
        let possible = Pace::of(&times)
            // As exact as such a clock, and as a person reads it.
            .map(|pace| (pace.rate * 1e3).round() / 1e3)
            .filter(|rate| (0.01..=1000.0).contains(rate));
        let mut name = clip_name(path);
        if topics.len() > 1 {
            name = plain_name(&format!("{name}{}", found.name.replace('/', "_")));
        }
        Ok(Self {
            messages: opened(path)?,
            path: path.to_owned(),
            name,
            rate: possible.unwrap_or(Pictures::DEFAULT_RATE),
            frames,
            topic: found.name.clone(),
            number: 0,
            is_cut: overview.damage.is_some(),
            is_over: false,
        })
    }

    fn read(&self, channel: &Channel, message: &Bytes) -> Result<EncodedPicture, EvalError> {
        let limits = FrameLimits::default();
        let named = |fault: &dyn std::fmt::Display| {
            EvalError::content(
                &self.path,
                format!("{}, picture {}: {fault}", self.topic, self.number),
            )
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
        Some(format!("{}, picture {}", self.path.display(), self.number))
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
                return self.read(&message.channel, &message.data).map(Some);
            }
        }
        self.is_over = true;
        match self.messages.damage() {
            Some(damage) if !self.is_cut => {
                let what = format!("the file is damaged, and nothing is read after this: {damage}");
                Err(EvalError::content(&self.path, what))
            }
            _ => Ok(None),
        }
    }

    fn rewind(&mut self) -> Result<(), EvalError> {
        self.messages = opened(&self.path)?;
        self.number = 0;
        self.is_over = false;
        Ok(())
    }
}
