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

use Kind::{Bool, Bytes, Double, Enum, Int32, Int64, Messages, Text, Uint32, Uint64, Uint64s};

/// A message: its name and its fields with their numbers.
type Fields = &'static [(&'static str, i32, Kind)];

const TIME: Kind = Kind::Message(".google.protobuf.Timestamp");
const POINT: &str = ".foxglove.Point2";
const COLOR: Kind = Kind::Message(".foxglove.Color");

/// Foxglove's messages (github.com/foxglove/foxglove-sdk, `schemas/proto`), with the fields that are written here: a reader
/// takes the others for absent.
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
const POINTS: [&str; 5] = ["UNKNOWN", "POINTS", "LINE_LOOP", "LINE_STRIP", "LINE_LIST"];

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
    let timestamp: &[(&str, Fields)] =
        &[("Timestamp", &[("seconds", 1, Int64), ("nanos", 2, Int32)])];
    let time = file(
        "google/protobuf/timestamp.proto",
        "google.protobuf",
        timestamp,
    );
    let foxglove = file("foxglove.proto", "foxglove", FOXGLOVE);
    let albireo = file("albireo.proto", "albireo", ALBIREO);
    let files = FileDescriptorSet {
        file: vec![time, foxglove, albireo],
    };
    files.encode_to_vec()
}

fn file(name: &str, package: &str, messages: &[(&str, Fields)]) -> FileDescriptorProto {
    const TIMESTAMP: &str = "google/protobuf/timestamp.proto";
    let message = |(name, fields): &(&str, Fields)| DescriptorProto {
        name: Some((*name).to_owned()),
        field: fields.iter().map(field).collect(),
        enum_type: (*name == "PointsAnnotation").then(points).into_iter().collect(),
        ..DescriptorProto::default()
    };
    FileDescriptorProto {
        name: Some(name.to_owned()),
        package: Some(package.to_owned()),
        dependency: (name != TIMESTAMP).then(|| TIMESTAMP.to_owned()).into_iter().collect(),
        message_type: messages.iter().map(message).collect(),
        syntax: Some("proto3".to_owned()),
        ..FileDescriptorProto::default()
    }
}

fn points() -> EnumDescriptorProto {
    let value = |(number, name): (i32, &str)| EnumValueDescriptorProto {
        name: Some(name.to_owned()),
        number: Some(number),
        options: None,
    };
    EnumDescriptorProto {
        name: Some("Type".to_owned()),
        value: (0..).zip(POINTS).map(value).collect(),
        ..EnumDescriptorProto::default()
    }
}

fn field(&(name, number, kind): &(&'static str, i32, Kind)) -> FieldDescriptorProto {
    let (of, type_name) = match kind {
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
        r#type: Some(of.into()),
        type_name: type_name.map(str::to_owned),
        json_name: Some(camel_case(name)),
        ..FieldDescriptorProto::default()
    }
}

/// The field's name in protobuf's JSON.
fn camel_case(name: &str) -> String {
    let mut parts = name.split('_');
    let first = parts.next().unwrap_or_default().to_owned();
    parts.fold(first, |whole, part| {
        let (initial, rest) = part.split_at(part.len().min(1));
        whole + &initial.to_ascii_uppercase() + rest
    })
}
