//! Reads from the bytes of an ONNX model what its graph says of its weights.

use std::collections::BTreeSet;

/// The files beside a model that hold its weights: the values of `location` wherever a tensor of the graph has its data
/// outside (`TensorProto.external_data` of ONNX, entries of a key and a value).
pub fn external_files(model: &[u8]) -> BTreeSet<String> {
    // Field 1, the key, of eight bytes; then field 2, the value.
    const LOCATION: &[u8] = b"\x0a\x08location\x12";
    let mut found = BTreeSet::new();
    let mut rest = model;
    while let Some(place) = rest.windows(LOCATION.len()).position(|bytes| bytes == LOCATION) {
        rest = &rest[place + LOCATION.len()..];
        let mut value = Fields(rest);
        if let Some(length) = value.number()
            && let Some(bytes) = value.bytes(length)
            && let Ok(name) = std::str::from_utf8(bytes)
        {
            found.insert(name.to_owned());
        }
    }
    found
}

/// Returns true if weights of an ONNX model are in half precision, which then is the model's own: an initializer of the
/// graph has the element type float16.
pub(crate) fn has_half_weights(model: &[u8]) -> bool {
    const GRAPH: u64 = 7;
    const INITIALIZER: u64 = 5;
    const DATA_TYPE: u64 = 2;
    const FLOAT16: u64 = 10;
    for field in Fields(model) {
        let (GRAPH, Value::Bytes(graph)) = field else {
            continue;
        };
        for field in Fields(graph) {
            let (INITIALIZER, Value::Bytes(tensor)) = field else {
                continue;
            };
            let is_half = |field| matches!(field, (DATA_TYPE, Value::Number(FLOAT16)));
            if Fields(tensor).any(is_half) {
                return true;
            }
        }
    }
    false
}

/// The fields of a message of Protocol Buffers, until its end or the first bytes that are no field.
struct Fields<'a>(&'a [u8]);

enum Value<'a> {
    Number(u64),
    Bytes(&'a [u8]),
    Other,
}

impl Fields<'_> {
    /// Takes the number at the front: seven bits of each byte, the lowest first; the eighth says that more follow.
    fn number(&mut self) -> Option<u64> {
        let mut number = 0;
        for place in 0..10 {
            let (&byte, rest) = self.0.split_first()?;
            self.0 = rest;
            number |= u64::from(byte & 127) << (7 * place);
            if byte < 128 {
                return Some(number);
            }
        }
        None
    }
}

impl<'a> Fields<'a> {
    /// Takes `length` bytes from the front.
    fn bytes(&mut self, length: u64) -> Option<&'a [u8]> {
        let (bytes, rest) = self.0.split_at_checked(usize::try_from(length).ok()?)?;
        self.0 = rest;
        Some(bytes)
    }
}

impl<'a> Iterator for Fields<'a> {
    type Item = (u64, Value<'a>);

    fn next(&mut self) -> Option<Self::Item> {
        let tag = self.number()?;
        let value = match tag & 7 {
            0 => Value::Number(self.number()?),
            2 => {
                let length = self.number()?;
                Value::Bytes(self.bytes(length)?)
            }
            1 => {
                self.bytes(8)?;
                Value::Other
            }
            5 => {
                self.bytes(4)?;
                Value::Other
            }
            _ => return None,
        };
        Some((tag >> 3, value))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    #[test]
    fn the_half_precision_of_a_model_is_seen_in_its_weights() {
        let fixtures = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures/models");
        let is_half = |name: &str| has_half_weights(&std::fs::read(fixtures.join(name)).unwrap());
        assert!(is_half("yolo_float16.onnx"));
        assert!(!is_half("colours.onnx"));
        assert!(!is_half("truncated.onnx"));
    }

    /// A length is of as many bytes as it needs, seven bits each.
    #[test]
    fn the_files_beside_a_model_are_found_whatever_the_length_of_their_names() {
        for length in [1, 127, 128, 20_000] {
            let name = "w".repeat(length);
            let mut model = b"\x0a\x08location\x12".to_vec();
            let mut rest = length;
            while rest >= 128 {
                model.push((rest % 128) as u8 | 128);
                rest /= 128;
            }
            model.push(rest as u8);
            model.extend_from_slice(name.as_bytes());
            assert_eq!(external_files(&model), BTreeSet::from([name]));
        }
    }
}
