//! Selects the classes that are reported, with their names and numbers.

use super::{DetectorConfig, StartError, class_names};
use albireo_core::detection::{BDD100K_CLASSES, ClassId};

/// Names in COCO and other data sets for classes of BDD100K.
const SYNONYMS: [(&str, &str); 5] = [
    ("person", "pedestrian"),
    ("people", "pedestrian"),
    ("bike", "bicycle"),
    ("motor", "motorcycle"),
    ("motorbike", "motorcycle"),
];

/// What becomes of the boxes of one class of a model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Reporting {
    /// They are reported as boxes of this class.
    As(ClassId),
    /// They are not reported.
    LeftOut,
    /// The model has no such class.
    NoSuchClass,
}

/// The reported classes, and the mapping from the model's classes to them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Classes {
    /// The names of the reported classes, by reported number.
    pub(super) reported: Vec<String>,
    /// The names of the model's classes that are not reported.
    pub(super) left_out: Vec<String>,
    /// The reported number of each class of the model; `None` if it is not reported.
    by_model: Vec<Option<ClassId>>,
}

impl Classes {
    /// Maps a model's classes with these names (empty: does not occur) to those that `config` reports.
    ///
    /// # Errors
    /// If the configuration contains a name that the model does not have.
    pub(super) fn new(names: &[String], config: &DetectorConfig) -> Result<Self, StartError> {
        let wrong = |key: &str, name: &str| {
            let names = named_classes(names).join(", ");
            let reason = format!("the model has no class `{name}`; it has {names}");
            StartError::configuration(key, reason)
        };
        if let Some(unknown) = config.class_map.keys().find(|&name| !names.contains(name)) {
            return Err(wrong("detector.class_map", unknown));
        }
        let renamed: Vec<&str> = names
            .iter()
            .map(|name| config.class_map.get(name).unwrap_or(name).as_str())
            .collect();
        let classes = match &config.report_classes {
            Some(wanted) if wanted.is_empty() => Self::all(&renamed),
            Some(wanted) => {
                let wanted: Vec<&str> = wanted.iter().map(String::as_str).collect();
                let classes = Self::only(&renamed, &wanted);
                for (place, name) in wanted.iter().enumerate() {
                    if !classes.by_model.contains(&Some(number(place))) {
                        return Err(wrong("detector.report_classes", name));
                    }
                }
                classes
            }
            // The paper's choice, for the data set that its detectors know. Whoever trained a model of his own wants to
            // see its classes.
            None if class_names::are_of_coco(names) => Self::only(&renamed, &BDD100K_CLASSES),
            None => Self::all(&renamed),
        };
        Ok(classes)
    }

    /// What becomes of the boxes of class `number` of the model.
    pub(super) fn reporting(&self, number: ClassId) -> Reporting {
        match self.by_model.get(usize::from(number.0)) {
            Some(Some(class)) => Reporting::As(*class),
            Some(None) => Reporting::LeftOut,
            None => Reporting::NoSuchClass,
        }
    }

    /// The `wanted` classes, under their own name or a synonym.
    fn only(names: &[&str], wanted: &[&str]) -> Self {
        let number_of = |name: &str| {
            let place = wanted.iter().position(|&wanted| wanted == name);
            place.map(number)
        };
        let mut by_model = Vec::with_capacity(names.len());
        for name in names {
            let under_own_name = number_of(name);
            let reported = under_own_name.or_else(|| synonym(name).and_then(number_of));
            by_model.push(reported);
        }
        Self {
            reported: wanted.iter().map(|&name| name.to_owned()).collect(),
            left_out: left_out(names, &by_model),
            by_model,
        }
    }

    /// All classes that have a name. If no name occurs twice, they keep their numbers.
    fn all(names: &[&str]) -> Self {
        let mut reported: Vec<String> = Vec::new();
        let mut by_model = Vec::with_capacity(names.len());
        for &name in names {
            if name.is_empty() {
                // It takes a place, so that those behind it keep theirs.
                reported.push(String::new());
                by_model.push(None);
                continue;
            }
            let place = match reported.iter().position(|known| known == name) {
                Some(place) => place,
                None => {
                    reported.push(name.to_owned());
                    reported.len() - 1
                }
            };
            by_model.push(Some(number(place)));
        }
        Self {
            reported,
            left_out: Vec::new(),
            by_model,
        }
    }
}

/// Those of the classes that occur: one without a name only takes a place.
pub fn named_classes(classes: &[String]) -> Vec<&str> {
    let names = classes.iter().map(String::as_str);
    names.filter(|name| !name.is_empty()).collect()
}

/// The name in BDD100K of what other data sets call `name`, if they differ.
fn synonym(name: &str) -> Option<&'static str> {
    let (_, ours) = SYNONYMS.iter().find(|(other, _)| *other == name)?;
    Some(ours)
}

/// The names of the classes that are not reported, without those that do not occur.
fn left_out(names: &[&str], by_model: &[Option<ClassId>]) -> Vec<String> {
    names
        .iter()
        .zip(by_model)
        .filter(|(name, reported)| reported.is_none() && !name.is_empty())
        .map(|(name, _)| (*name).to_owned())
        .collect()
}

/// An index into a list of names as a class number; no list is longer than the numbers reach.
fn number(place: usize) -> ClassId {
    ClassId(u16::try_from(place).unwrap_or(u16::MAX))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detector::class_names::COCO_CLASSES;

    fn owned(names: &[&str]) -> Vec<String> {
        names.iter().map(|&name| name.to_owned()).collect()
    }

    fn classes(names: &[&str], config: &DetectorConfig) -> Classes {
        Classes::new(&owned(names), config).unwrap()
    }

    fn config(report: Option<&[&str]>, map: &[(&str, &str)]) -> DetectorConfig {
        let pair = |&(from, to): &(&str, &str)| (from.to_owned(), to.to_owned());
        DetectorConfig {
            report_classes: report.map(owned),
            class_map: map.iter().map(pair).collect(),
            ..DetectorConfig::default()
        }
    }

    /// The name under which a class of the model is reported.
    fn name(classes: &Classes, number: u16) -> Option<&str> {
        match classes.reporting(ClassId(number)) {
            Reporting::As(reported) => Some(&classes.reported[usize::from(reported.0)]),
            Reporting::LeftOut => None,
            Reporting::NoSuchClass => panic!("the model has no class {number}"),
        }
    }

    fn has_own_numbers(classes: &Classes, count: u16) -> bool {
        (0..count)
            .map(ClassId)
            .all(|number| classes.reporting(number) == Reporting::As(number))
    }

    #[test]
    fn by_default_the_seven_classes_of_bdd100k_are_reported_of_coco() {
        let names: Vec<_> = COCO_CLASSES.lines().collect();
        let coco = classes(&names, &DetectorConfig::default());
        assert_eq!(coco.reported, BDD100K_CLASSES);
        let reported = [0, 1, 2, 3, 5, 7].map(|number| name(&coco, number).unwrap());
        let expected = ["pedestrian", "bicycle", "car", "motorcycle", "bus", "truck"];
        assert_eq!(reported, expected);
    }

    #[test]
    fn classes_that_are_not_reported_are_left_out_by_name() {
        let names: Vec<_> = COCO_CLASSES.lines().collect();
        let coco = classes(&names, &DetectorConfig::default());
        // COCO has all of BDD100K but the rider.
        let reported = BDD100K_CLASSES.len() - 1;
        assert_eq!(coco.left_out.len(), names.len() - reported);
        assert!(coco.left_out.contains(&"traffic light".to_owned()));
    }

    #[test]
    fn a_class_that_is_left_out_is_told_from_a_number_beyond_the_names() {
        let one_of_two = classes(&["car", "bus"], &config(Some(&["car"]), &[]));
        assert_eq!(one_of_two.reporting(ClassId(1)), Reporting::LeftOut);
        assert_eq!(one_of_two.reporting(ClassId(2)), Reporting::NoSuchClass);
    }

    #[test]
    fn by_default_all_classes_of_a_model_of_one_s_own_are_reported() {
        let names: [&[&str]; 2] = [&BDD100K_CLASSES, &["helmet", "person", "vest"]];
        for names in names {
            let own = classes(names, &DetectorConfig::default());
            assert_eq!(own.reported, names);
            assert!(has_own_numbers(&own, names.len() as u16));
            assert!(own.left_out.is_empty());
        }
    }

    #[test]
    fn a_class_without_a_name_is_not_reported_and_the_others_keep_their_numbers() {
        let fish = classes(&["cod", "", "", "ray"], &DetectorConfig::default());
        let reported = [0, 1, 2, 3].map(|number| name(&fish, number));
        assert_eq!(reported, [Some("cod"), None, None, Some("ray")]);
        assert_eq!(fish.reporting(ClassId(3)), Reporting::As(ClassId(3)));
    }

    #[test]
    fn a_list_reports_only_its_classes_under_its_numbers() {
        let listed = config(Some(&["bus", "pedestrian", "person"]), &[("train", "bus")]);
        let some = classes(&["car", "person", "train", "bus", "people"], &listed);
        assert_eq!(name(&some, 0), None);
        let reported = [1, 2, 3, 4].map(|number| name(&some, number).unwrap());
        assert_eq!(reported, ["person", "bus", "bus", "pedestrian"]);
        assert_eq!(some.reporting(ClassId(3)), Reporting::As(ClassId(0)));
    }

    #[test]
    fn an_empty_list_reports_all_classes_under_their_own_numbers() {
        let names: Vec<_> = COCO_CLASSES.lines().collect();
        let coco = classes(&names, &config(Some(&[]), &[]));
        assert_eq!(coco.reported, names);
        assert!(has_own_numbers(&coco, 80));
    }

    #[test]
    fn a_class_without_a_name_is_not_listed() {
        let names = owned(&["", "car", "", "bus"]);
        assert_eq!(named_classes(&names), ["car", "bus"]);
        let lorry = config(Some(&["lorry"]), &[]);
        let error = Classes::new(&names, &lorry).unwrap_err().to_string();
        assert!(error.ends_with("it has car, bus"), "{error}");
    }

    #[test]
    fn an_unknown_class_name_is_an_error_that_lists_the_known_ones() {
        for (config, key) in [
            (config(Some(&["lorry"]), &[]), "detector.report_classes"),
            (config(None, &[("lorry", "truck")]), "detector.class_map"),
        ] {
            let error = Classes::new(&owned(&["car", "bus"]), &config).unwrap_err().to_string();
            for part in [key, "lorry", "car, bus"] {
                assert!(error.contains(part), "{error}");
            }
        }
    }
}
