//! What Home Assistant needs to know to show a node and its cameras as devices: its MQTT discovery of devices.
//! <https://www.home-assistant.io/integrations/mqtt/#mqtt-discovery>

use albireo_vision::detector::named_classes;
use serde_json::{Map, Value, json};

/// The most classes of a camera that get entities: a model may have thousands.
pub(super) const MOST_CLASSES: usize = 24;

/// A class, with its part of topics and ids.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct NamedClass {
    pub class: String,
    pub id: String,
}

/// The characters of a topic's level and of an id that Home Assistant takes.
pub(super) fn id_of(name: &str) -> String {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
    name.chars().map(|c| if is_plain(c) { c } else { '_' }).collect()
}

/// The id of `name`, with a further `_` for as long as another one has it.
fn own_id(name: &str, is_taken: impl Fn(&str) -> bool) -> String {
    let mut id = id_of(name);
    while is_taken(&id) {
        id.push('_');
    }
    id
}

/// The ids of a node's cameras, in order, each its own: the cameras `a.b` and `a_b` are two devices.
pub(super) fn camera_ids<'a>(cameras: impl Iterator<Item = &'a str>) -> Vec<String> {
    let mut ids = Vec::<String>::new();
    for camera in cameras {
        let id = own_id(camera, |id| ids.iter().any(|other| other == id));
        ids.push(id);
    }
    ids
}

/// The classes that get entities, each with an id of its own. Classes of one name are one.
pub(super) fn named(classes: &[String]) -> Vec<NamedClass> {
    let mut named = Vec::<NamedClass>::new();
    for class in named_classes(classes) {
        if named.len() == MOST_CLASSES {
            break;
        }
        if named.iter().any(|one| one.class == class) {
            continue;
        }
        let id = own_id(class, |id| named.iter().any(|one| one.id == id));
        named.push(NamedClass {
            class: class.to_owned(),
            id,
        });
    }
    named
}

/// A message by which Home Assistant discovers a device.
pub(super) struct DiscoveryMessage {
    pub topic: String,
    pub payload: String,
}

/// The node in discovery messages.
#[derive(Clone, Debug)]
pub(super) struct Described {
    /// First level of discovery topics.
    pub discovery: String,
    /// First levels of the node's topics: prefix and node.
    pub base: String,
    /// The node's id among all devices.
    pub id: String,
    /// The node's name.
    pub node: String,
    /// The detector's model.
    pub model: String,
    /// The address of the node's page.
    pub page: Option<String>,
}

impl Described {
    fn topic(&self, device: &str) -> String {
        format!("{}/device/{device}/config", self.discovery)
    }

    /// The parts that all messages share: the device, the program, and when it can be reached.
    fn device(&self, id: &str, name: &str, topics: &[String]) -> Map<String, Value> {
        let mut device = json!({
            "identifiers": [id], "name": name, "manufacturer": "albireo",
            "model": self.model, "sw_version": env!("CARGO_PKG_VERSION"),
        });
        if id != self.id {
            device["via_device"] = self.id.as_str().into();
        }
        if let Some(page) = &self.page {
            device["configuration_url"] = page.as_str().into();
        }
        let availability: Vec<_> = topics.iter().map(|topic| json!({ "topic": topic })).collect();
        let mut shared = Map::new();
        shared.insert("device".to_owned(), device);
        let origin = json!({ "name": "albireo", "sw_version": env!("CARGO_PKG_VERSION") });
        shared.insert("origin".to_owned(), origin);
        shared.insert("availability".to_owned(), availability.into());
        shared.insert("availability_mode".to_owned(), "all".into());
        shared.insert("qos".to_owned(), 1.into());
        shared
    }

    /// The message about the node: its power, which is `measured`, `partial` or `estimated`.
    pub(super) fn node(&self, power: Option<&str>) -> DiscoveryMessage {
        let Self { base, id, node, .. } = self;
        let mut message = self.device(id, node, &[format!("{base}/availability")]);
        let mut components = Map::new();
        if let Some(quality) = power {
            // An id of its own for each quality: measured and estimated figures are never one series.
            let power = json!({
                "platform": "sensor", "unique_id": format!("{id}_power_{quality}"), "name": format!("Power ({quality})"),
                "state_topic": format!("{base}/figures"), "device_class": "power", "state_class": "measurement",
                "unit_of_measurement": "W", "suggested_display_precision": 1,
                "value_template":
                    format!("{{{{ value_json.watts if value_json.power == '{quality}' else None }}}}"),
            });
            components.insert(format!("power_{quality}"), power);
        }
        let problem = json!({
            "platform": "binary_sensor", "unique_id": format!("{id}_problem"), "name": "Problem",
            "state_topic": format!("{base}/figures"), "device_class": "problem", "entity_category": "diagnostic",
            "value_template": "{{ 'OFF' if value_json.state == 'ready' else 'ON' }}",
        });
        components.insert("problem".to_owned(), problem);
        message.insert("components".to_owned(), components.into());
        DiscoveryMessage {
            topic: self.topic(id),
            payload: Value::from(message).to_string(),
        }
    }

    /// The message about a camera: for each class whether it is there and how many boxes it has, and the detector's calls.
    /// `id` is the camera's among those of the node.
    pub(super) fn camera(
        &self,
        camera: &str,
        id: &str,
        classes: &[NamedClass],
    ) -> DiscoveryMessage {
        let Self { base, node, .. } = self;
        let id = format!("{}_{id}", self.id);
        let topics = [
            format!("{base}/availability"),
            format!("{base}/{camera}/availability"),
        ];
        let mut message = self.device(&id, &format!("{node} {camera}"), &topics);
        let mut components = Map::new();
        for one in classes {
            let class = &one.class;
            let class_id = &one.id;
            let topic = format!("{base}/{camera}/class/{class_id}");
            let there = json!({
                "platform": "binary_sensor", "unique_id": format!("{id}_{class_id}"), "name": class,
                "device_class": "occupancy", "state_topic": topic,
            });
            let count = json!({
                "platform": "sensor", "unique_id": format!("{id}_{class_id}_count"), "name": format!("{class} count"),
                "state_topic": format!("{topic}/count"), "state_class": "measurement",
            });
            components.insert(class_id.clone(), there);
            components.insert(format!("{class_id}_count"), count);
        }
        let figures = format!("{base}/{camera}/figures");
        let calls = json!({
            "platform": "sensor", "unique_id": format!("{id}_detector_calls"), "name": "Detector calls",
            "state_topic": figures, "state_class": "total_increasing", "entity_category": "diagnostic",
            "value_template": "{{ value_json.detector_calls }}",
        });
        let skipped = json!({
            "platform": "sensor", "unique_id": format!("{id}_skipped"), "name": "Detector skipped",
            "state_topic": figures, "state_class": "measurement", "entity_category": "diagnostic",
            "unit_of_measurement": "%", "suggested_display_precision": 1,
            "value_template": "{{ value_json.skip_rate * 100 }}",
        });
        components.insert("albireo_detector_calls".to_owned(), calls);
        components.insert("albireo_detector_skipped".to_owned(), skipped);
        message.insert("components".to_owned(), components.into());
        DiscoveryMessage {
            topic: self.topic(&id),
            payload: Value::from(message).to_string(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    /// The keys that Home Assistant's schema has for these parts, from its source (homeassistant/components/mqtt: schemas.py,
    /// sensor.py, binary_sensor.py, and the entity options in entity.py) as of 2026; `!` marks the required ones.
    const DEVICE: &str = "identifiers connections manufacturer model model_id name hw_version serial_number sw_version \
        via_device suggested_area configuration_url";
    const ORIGIN: &str = "name! sw_version support_url";
    const MESSAGE: &str = "device! components! origin! state_topic command_topic qos encoding availability availability_mode \
        availability_topic availability_template payload_available payload_not_available";
    const ENTITY: &str = "platform! unique_id! name device_class state_topic! value_template qos encoding enabled_by_default \
        entity_category entity_picture icon json_attributes_topic json_attributes_template default_entity_id expire_after force_update";
    const SENSOR: &str = "unit_of_measurement suggested_display_precision state_class last_reset_value_template options";
    const BINARY_SENSOR: &str = "payload_on payload_off off_delay";

    fn described() -> Described {
        Described {
            discovery: "homeassistant".to_owned(),
            base: "fleet/north/car-7".to_owned(),
            id: "fleet_north_car-7".to_owned(),
            node: "car-7".to_owned(),
            model: "yolox_nano.onnx".to_owned(),
            page: Some("http://car-7.example:8080/".to_owned()),
        }
    }

    #[track_caller]
    fn holds(part: &Value, schema: &str) {
        let keys: BTreeSet<_> = part.as_object().unwrap().keys().map(String::as_str).collect();
        let known: BTreeSet<_> =
            schema.split_whitespace().map(|key| key.trim_end_matches('!')).collect();
        let unknown: Vec<_> = keys.difference(&known).collect();
        assert!(unknown.is_empty(), "{unknown:?} in {part}");
        let mut required = schema.split_whitespace().filter_map(|key| key.strip_suffix('!'));
        let missing = required.find(|key| !keys.contains(key));
        assert_eq!(missing, None, "{part}");
    }

    /// Holds a message against the schema; returns the ids of its entities.
    fn check(discovery: &DiscoveryMessage) -> Vec<String> {
        let topic = discovery.topic.strip_prefix("homeassistant/device/").unwrap();
        let id = topic.strip_suffix("/config").unwrap();
        assert_eq!(id, id_of(id), "{topic}");
        let message: Value = serde_json::from_str(&discovery.payload).unwrap();
        holds(&message, MESSAGE);
        holds(&message["device"], DEVICE);
        assert_eq!(message["device"]["identifiers"][0], *id);
        holds(&message["origin"], ORIGIN);
        for one in message["availability"].as_array().unwrap() {
            holds(
                one,
                "topic! payload_available payload_not_available value_template",
            );
        }
        let entity = |part: &Value| {
            let schema = match part["platform"].as_str().unwrap() {
                "sensor" => SENSOR,
                "binary_sensor" => BINARY_SENSOR,
                other => panic!("{other} in {part}"),
            };
            holds(part, &format!("{ENTITY} {schema}"));
            part["unique_id"].as_str().unwrap().to_owned()
        };
        message["components"].as_object().unwrap().values().map(entity).collect()
    }

    #[test]
    fn the_messages_follow_home_assistants_schema_and_each_entity_has_its_own_id() {
        let described = described();
        let classes = named(&["car", "traffic light", "traffic_light", "car"].map(str::to_owned));
        let ids: Vec<_> = classes.iter().map(|one| one.id.as_str()).collect();
        assert_eq!(ids, ["car", "traffic_light", "traffic_light_"]);
        let mut entities = check(&described.node(Some("estimated")));
        entities.extend(check(&described.node(Some("measured"))));
        entities.extend(check(&described.camera("front", "front", &classes)));
        let cameras = ["rear.2", "rear_2"];
        let ids = camera_ids(cameras.into_iter());
        assert_eq!(ids, ["rear_2", "rear_2_"]);
        for (camera, id) in cameras.into_iter().zip(&ids) {
            entities.extend(check(&described.camera(camera, id, &classes)));
        }
        assert_eq!(entities.len(), 2 + 2 + 3 * 8);
        // Both messages about the node have this one entity.
        let problem = described.id.clone() + "_problem";
        entities.retain(|id| *id != problem);
        let unique: BTreeSet<_> = entities.iter().collect();
        assert_eq!(unique.len(), entities.len(), "{entities:?}");
    }

    #[test]
    fn a_class_without_a_name_gets_no_entity() {
        let classes = named(&["", "car", "", "bus"].map(str::to_owned));
        let names: Vec<_> = classes.iter().map(|one| one.class.as_str()).collect();
        assert_eq!(names, ["car", "bus"]);
    }

    #[test]
    fn a_model_of_a_thousand_classes_gets_a_bounded_message() {
        let classes: Vec<_> = (0..1000).map(|number| format!("class {number}")).collect();
        let bytes = described().camera("front", "front", &named(&classes)).payload.len();
        assert!(bytes < 20_000, "{bytes}");
        assert_eq!(named(&classes).len(), MOST_CLASSES);
    }
}
