//! The schemas that a file carries, so that a reader needs nothing but the file.

use prost::Message;
use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::{
    DescriptorProto, EnumDescriptorProto, EnumValueDescriptorProto, FieldDescriptorProto,
    FileDescriptorProto, FileDescriptorSet,
};

/// The type of a field.
#[derive(Clone, Copy)]
enum Kind {
    Double,
    Bool,
    Int32,
    Int64,
    Uint32,
    Uint64,
    Text,
    Bytes,
    /// The enumeration of this full name.
    Enum(&'static str),
    /// The message of this full name.
    Message(&'static str),
    /// Several messages of this full name.
    Messages(&'static str),
    /// Several numbers.
    Uint64s,
}

// Without `Message`, which would clash with the trait of that name.
use Kind::{Bool, Bytes, Double, Enum, Int32, Int64, Messages, Text, Uint32, Uint64, Uint64s};

/// A field: its name, its number in the encoded message, and its type.
type Field = (&'static str, i32, Kind);

/// The fields of a message.
type Fields = &'static [Field];

const TIME: Kind = Kind::Message(".google.protobuf.Timestamp");
const POINT: &str = ".foxglove.Point2";
const COLOR: Kind = Kind::Message(".foxglove.Color");

/// Foxglove's messages (github.com/foxglove/foxglove-sdk, `schemas/proto`), with the fields that are written here: a
/// reader takes the others for absent.
const FOXGLOVE: &[(&str, Fields)] = &[
    (
        "CompressedImage",
        &[
            ("timestamp", 1, TIME),
            ("data", 2, Bytes),
            ("format", 3, Text),
            ("frame_id", 4, Text),
        ],
    ),
    (
        "ImageAnnotations",
        &[
            ("points", 2, Messages(".foxglove.PointsAnnotation")),
            ("texts", 3, Messages(".foxglove.TextAnnotation")),
            ("timestamp", 5, TIME),
        ],
    ),
    (
        "PointsAnnotation",
        &[
            ("timestamp", 1, TIME),
            ("type", 2, Enum(".foxglove.PointsAnnotation.Type")),
            ("points", 3, Messages(POINT)),
            ("outline_color", 4, COLOR),
            ("thickness", 7, Double),
        ],
    ),
    (
        "TextAnnotation",
        &[
            ("timestamp", 1, TIME),
            ("position", 2, Kind::Message(POINT)),
            ("text", 3, Text),
            ("font_size", 4, Double),
            ("text_color", 5, COLOR),
        ],
    ),
    (
        "LocationFix",
        &[
            ("latitude", 1, Double),
            ("longitude", 2, Double),
            ("timestamp", 6, TIME),
            ("frame_id", 7, Text),
        ],
    ),
    ("Point2", &[("x", 1, Double), ("y", 2, Double)]),
    (
        "Color",
        &[
            ("r", 1, Double),
            ("g", 2, Double),
            ("b", 3, Double),
            ("a", 4, Double),
        ],
    ),
];

/// The values of `PointsAnnotation.Type`.
const POINTS_TYPES: [&str; 5] = ["UNKNOWN", "POINTS", "LINE_LOOP", "LINE_STRIP", "LINE_LIST"];

/// The file of the timestamp, which readers know by this name.
const TIMESTAMP_FILE: &str = "google/protobuf/timestamp.proto";

const TIMESTAMP: &[(&str, Fields)] =
    &[("Timestamp", &[("seconds", 1, Int64), ("nanos", 2, Int32)])];

/// The messages of this program.
const ALBIREO: &[(&str, Fields)] = &[(
    "Figures",
    &[
        ("timestamp", 1, TIME),
        ("seq", 2, Uint64),
        ("state", 3, Int32),
        ("skipped", 4, Bool),
        ("degraded", 5, Bool),
        ("tau_max", 6, Double),
        ("threshold", 7, Double),
        ("boxes", 8, Uint32),
        ("objects", 9, Uint64s),
        ("latency_ms", 10, Double),
        ("speed_m_s", 11, Double),
    ],
)];

/// The schema of all messages in protobuf: a serialised `FileDescriptorSet`.
pub(crate) fn protobuf() -> Vec<u8> {
    let timestamp = file(TIMESTAMP_FILE, "google.protobuf", TIMESTAMP);
    let mut foxglove = file("foxglove.proto", "foxglove", FOXGLOVE);
    let mut albireo = file("albireo.proto", "albireo", ALBIREO);
    for importing in [&mut foxglove, &mut albireo] {
        importing.dependency.push(TIMESTAMP_FILE.to_owned());
    }
    let files = FileDescriptorSet {
        file: vec![timestamp, foxglove, albireo],
    };
    files.encode_to_vec()
}

/// A file of messages, as the compiler of protobuf would describe it.
fn file(name: &str, package: &str, messages: &[(&str, Fields)]) -> FileDescriptorProto {
    FileDescriptorProto {
        name: Some(name.to_owned()),
        package: Some(package.to_owned()),
        message_type: messages.iter().map(|(name, fields)| message(name, fields)).collect(),
        syntax: Some("proto3".to_owned()),
        ..FileDescriptorProto::default()
    }
}

fn message(name: &str, fields: Fields) -> DescriptorProto {
    let mut message = DescriptorProto {
        name: Some(name.to_owned()),
        field: fields.iter().map(field).collect(),
        ..DescriptorProto::default()
    };
    // The only message that declares a type of its own.
    if name == "PointsAnnotation" {
        message.enum_type.push(points_type());
    }
    message
}

/// The enumeration `PointsAnnotation.Type`.
fn points_type() -> EnumDescriptorProto {
    let value = |(number, name): (i32, &str)| EnumValueDescriptorProto {
        name: Some(name.to_owned()),
        number: Some(number),
        options: None,
    };
    EnumDescriptorProto {
        name: Some("Type".to_owned()),
        value: (0..).zip(POINTS_TYPES).map(value).collect(),
        ..EnumDescriptorProto::default()
    }
}

fn field(&(name, number, kind): &Field) -> FieldDescriptorProto {
    let (field_type, type_name) = match kind {
        Double => (Type::Double, None),
        Bool => (Type::Bool, None),
        Int32 => (Type::Int32, None),
        Int64 => (Type::Int64, None),
        Uint32 => (Type::Uint32, None),
        Uint64 | Uint64s => (Type::Uint64, None),
        Text => (Type::String, None),
        Bytes => (Type::Bytes, None),
        Enum(name) => (Type::Enum, Some(name)),
        Kind::Message(name) | Messages(name) => (Type::Message, Some(name)),
    };
    let label = match kind {
        Messages(_) | Uint64s => Label::Repeated,
        _ => Label::Optional,
    };
    FieldDescriptorProto {
        name: Some(name.to_owned()),
        number: Some(number),
        label: Some(label.into()),
        r#type: Some(field_type.into()),
        type_name: type_name.map(str::to_owned),
        json_name: Some(camel_case(name)),
        ..FieldDescriptorProto::default()
    }
}

/// The field's name in protobuf's JSON.
fn camel_case(name: &str) -> String {
    let mut whole = String::with_capacity(name.len());
    let mut follows_underscore = false;
    for letter in name.chars() {
        if letter == '_' {
            follows_underscore = true;
        } else if follows_underscore {
            whole.push(letter.to_ascii_uppercase());
            follows_underscore = false;
        } else {
            whole.push(letter);
        }
    }
    whole
}
