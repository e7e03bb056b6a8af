//! Reads recordings of any writer, message by message, as far as they are whole.

use crate::RecordingError;
use bytes::Bytes;
use mcap::records::Record;
use mcap::sans_io::{
    LinearReadEvent, LinearReader, LinearReaderOptions, SummaryReadEvent, SummaryReader,
    SummaryReaderOptions,
};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{Read, Seek};
use std::path::Path;
use std::sync::Arc;

/// Longest record that is read: a larger one is a broken length, or no picture.
const LONGEST_RECORD: usize = 1 << 30;

/// A channel: a topic with its schema.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Channel {
    /// The topic's name.
    pub topic: String,
    /// The encoding of its messages: `json`, `protobuf`, `cdr` …
    pub encoding: String,
    /// The name of its messages' type; empty if there is no schema.
    pub schema: String,
    pub(crate) definition: Definition,
}

/// What a schema says, in the language of its encoding: `protobuf`, `jsonschema`, `ros2msg` …
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Definition {
    pub encoding: String,
    pub text: Vec<u8>,
}

/// A schema, whose name its channels repeat.
#[derive(Clone, Default)]
struct Schema {
    name: String,
    definition: Definition,
}

/// A message.
#[derive(Clone, Debug)]
pub struct Message {
    /// Its channel.
    pub channel: Arc<Channel>,
    /// The time at which it was recorded, nanoseconds since the Unix epoch or since the start of a clock.
    pub time_ns: u64,
    /// The message.
    pub data: Bytes,
}

/// The messages of a file, in the file's order. After a damaged place there are none: [`damage`](Self::damage) says so.
pub struct Messages {
    file: File,
    reader: LinearReader,
    schemas: BTreeMap<u16, Schema>,
    channels: BTreeMap<u16, Arc<Channel>>,
    /// Why there are no more.
    damage: Option<String>,
}

impl Messages {
    /// Opens a file.
    ///
    /// # Errors
    /// If it cannot be opened.
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        let options = LinearReaderOptions::default()
            .with_prevalidate_chunk_crcs(true)
            .with_record_length_limit(LONGEST_RECORD);
        let reader = LinearReader::new_with_options(options);
        #[cfg(feature = "compressed")]
        let reader = with_zstandard(reader)?;
        Ok(Self {
            file: File::open(path)?,
            reader,
            schemas: BTreeMap::new(),
            channels: BTreeMap::new(),
            damage: None,
        })
    }

    /// The place at which reading stopped before the file's end, in words: a file that was being written when the power
    /// went, or a damaged one. Known after the last message.
    pub fn damage(&self) -> Option<&str> {
        self.damage.as_deref()
    }

    /// The next message, or `None` at the end. Notes the schemas and channels on the way to it.
    pub(crate) fn advance(&mut self) -> Result<Option<Message>, RecordingError> {
        while let Some(record) = self.next_record()? {
            match record {
                Record::Schema { header, data } => {
                    let schema = Schema {
                        name: header.name,
                        definition: Definition {
                            encoding: header.encoding,
                            text: data.into_owned(),
                        },
                    };
                    self.schemas.insert(header.id, schema);
                }
                Record::Channel(channel) => {
                    let schema = self.schemas.get(&channel.schema_id).cloned().unwrap_or_default();
                    let known = Channel {
                        topic: channel.topic,
                        encoding: channel.message_encoding,
                        schema: schema.name,
                        definition: schema.definition,
                    };
                    // A file may repeat it. The first one stays, so that all its messages share it.
                    self.channels.entry(channel.id).or_insert_with(|| Arc::new(known));
                }
                Record::Message { header, data } => {
                    if let Some(channel) = self.channels.get(&header.channel_id) {
                        return Ok(Some(Message {
                            channel: Arc::clone(channel),
                            time_ns: header.log_time,
                            data: Bytes::from(data.into_owned()),
                        }));
                    }
                }
                Record::Footer(_) => return Ok(None),
                _ => {}
            }
        }
        Ok(None)
    }

    /// The next record. The reader does no reading itself: it asks for the bytes that it needs.
    fn next_record(&mut self) -> Result<Option<Record<'static>>, RecordingError> {
        while let Some(event) = self.reader.next_event() {
            match event? {
                LinearReadEvent::ReadRequest(wanted) => {
                    let buffer = self.reader.insert(wanted);
                    let read = self.file.read(buffer)?;
                    self.reader.notify_read(read);
                }
                LinearReadEvent::Record { data, opcode } => {
                    let record = mcap::parse_record(opcode, data)?;
                    return Ok(Some(record.into_owned()));
                }
            }
        }
        Ok(None)
    }
}

#[cfg(feature = "compressed")]
fn with_zstandard(mut reader: LinearReader) -> Result<LinearReader, RecordingError> {
    reader.add_decompressor(crate::zstandard::Zstandard::new()?)?;
    Ok(reader)
}

impl Iterator for Messages {
    type Item = Message;

    fn next(&mut self) -> Option<Message> {
        if self.damage.is_some() {
            return None;
        }
        match self.advance() {
            Ok(message) => message,
            Err(error) => {
                self.damage = Some(error.to_string());
                None
            }
        }
    }
}

/// What a file holds, without its messages.
#[derive(Clone, Debug, Default)]
pub struct Overview {
    /// The channels in the order of their topics, and the number of messages of each.
    pub channels: Vec<(Arc<Channel>, u64)>,
    /// Why the file has no end, if it has none.
    pub damage: Option<String>,
}

impl Overview {
    /// Reads the index at the end of a file, or all its messages if it has none.
    ///
    /// # Errors
    /// If it cannot be read, or is no MCAP file.
    pub fn read(path: &Path) -> Result<Self, RecordingError> {
        let mut overview = match indexed(path) {
            Ok(Some(overview)) => overview,
            // It has no index, or was cut.
            Ok(None) | Err(RecordingError::Mcap(_)) => counted(path)?,
            Err(error) => return Err(error),
        };
        overview.channels.sort_by(|(one, _), (other, _)| one.topic.cmp(&other.topic));
        Ok(overview)
    }

    fn count(&mut self, message: &Message) {
        let mut channels = self.channels.iter_mut();
        let known = channels.find(|(channel, _)| Arc::ptr_eq(channel, &message.channel));
        match known {
            Some((_, count)) => *count += 1,
            None => self.channels.push((Arc::clone(&message.channel), 1)),
        }
    }
}

/// The overview of all messages, read one by one.
fn counted(path: &Path) -> Result<Overview, RecordingError> {
    let mut overview = Overview::default();
    let mut messages = Messages::open(path)?;
    for message in messages.by_ref() {
        overview.count(&message);
    }
    match messages.damage {
        Some(damage) if overview.channels.is_empty() => Err(RecordingError::Message(damage)),
        damage => Ok(Overview { damage, ..overview }),
    }
}

/// The overview by the index; `None` if the file has none, or one without counts.
fn indexed(path: &Path) -> Result<Option<Overview>, RecordingError> {
    let Some(summary) = summary(path)? else {
        return Ok(None);
    };
    let Some(counts) = summary.stats else {
        return Ok(None);
    };
    let channels = summary.channels.values().map(|channel| {
        let count = counts.channel_message_counts.get(&channel.id).copied();
        (Arc::new(known_channel(channel)), count.unwrap_or(0))
    });
    Ok(Some(Overview {
        channels: channels.collect(),
        damage: None,
    }))
}

fn known_channel(channel: &mcap::Channel<'_>) -> Channel {
    let schema = channel.schema.as_ref();
    let definition = schema.map(|schema| Definition {
        encoding: schema.encoding.clone(),
        text: schema.data.to_vec(),
    });
    Channel {
        topic: channel.topic.clone(),
        encoding: channel.message_encoding.clone(),
        schema: schema.map(|schema| schema.name.clone()).unwrap_or_default(),
        definition: definition.unwrap_or_default(),
    }
}

/// The summary at the end of a file; `None` if there is none. As in [`Messages`], the reader asks for its bytes.
fn summary(path: &Path) -> Result<Option<mcap::Summary>, RecordingError> {
    let mut file = File::open(path)?;
    let size = file.metadata()?.len();
    let options = SummaryReaderOptions::default()
        .with_file_size(size)
        .with_record_length_limit(LONGEST_RECORD);
    let mut reader = SummaryReader::new_with_options(options);
    while let Some(event) = reader.next_event() {
        match event? {
            SummaryReadEvent::SeekRequest(to) => reader.notify_seeked(file.seek(to)?),
            SummaryReadEvent::ReadRequest(wanted) => {
                let read = file.read(reader.insert(wanted))?;
                reader.notify_read(read);
            }
        }
    }
    Ok(reader.finish())
}
