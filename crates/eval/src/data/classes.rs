//! Defines the classes that are evaluated, and maps the names of data sets to them.
//!
//! The paper evaluates the classes of BDD100K that COCO also has, with pedestrian and rider both taken as person: six
//! classes, with COCO's numbers counted from 0. A model with other classes is evaluated with its own, under its
//! numbers.

use super::LeftOut;
use crate::error::EvalError;
use albireo_core::detection::ClassId;
use albireo_vision::detector::{are_of_coco, named_classes};
use std::sync::Arc;

/// A person, walking or riding.
pub(crate) const PERSON: ClassId = ClassId(0);
pub(crate) const BICYCLE: ClassId = ClassId(1);
pub(crate) const CAR: ClassId = ClassId(2);
pub(crate) const MOTORCYCLE: ClassId = ClassId(3);
pub(crate) const BUS: ClassId = ClassId(5);
pub(crate) const TRUCK: ClassId = ClassId(7);

/// The evaluated classes with their names, in order of their numbers.
pub(crate) const EVALUATED: [(ClassId, &str); 6] = [
    (PERSON, "person"),
    (BICYCLE, "bicycle"),
    (CAR, "car"),
    (MOTORCYCLE, "motorcycle"),
    (BUS, "bus"),
    (TRUCK, "truck"),
];

/// The classes of BDD100K that are not evaluated. Ground truth with any further class is not BDD100K's.
const OTHERS_OF_BDD100K: [&str; 6] = [
    "train",
    "traffic light",
    "traffic sign",
    "other person",
    "other vehicle",
    "trailer",
];

/// The most names of classes or clips that an error lists in a row.
pub(super) const MOST_NAMED: usize = 8;

/// The classes that a run evaluates.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Evaluated {
    /// The six of the paper, with COCO's numbers.
    #[default]
    Road,
    /// Those of a model, with its numbers; the name is empty of one that is not evaluated.
    Own(Arc<[String]>),
}

impl Evaluated {
    /// Returns what is evaluated of a model without ground truth: its own classes, except that a model with COCO's
    /// eighty, or with no class beside the six, is evaluated with these six.
    pub fn of_model(names: &[String]) -> Self {
        let named = named_classes(names);
        let are_all_six = !named.is_empty() && named.iter().all(|name| from_name(name).is_ok());
        if are_of_coco(names) || are_all_six {
            Self::Road
        } else {
            Self::Own(names.into())
        }
    }

    /// The number of the class that a data set or a model calls `name`. Of a model's own classes it is the one of that
    /// name, else the first that is the same of the six: `pedestrian` for `person`.
    pub fn find(&self, name: &str) -> Result<ClassId, LeftOut> {
        let Self::Own(names) = self else {
            return from_name(name);
        };
        if name.is_empty() {
            return Err(LeftOut::UnmappedClass);
        }
        let mut place = names.iter().position(|own| own.eq_ignore_ascii_case(name));
        let of_six = from_name(name);
        if place.is_none() && of_six.is_ok() {
            place = names.iter().position(|own| from_name(own) == of_six);
        }
        match place.map(u16::try_from) {
            Some(Ok(number)) => Ok(ClassId(number)),
            _ => Err(LeftOut::UnmappedClass),
        }
    }

    /// Makes sure that a model with the classes `names` has one of them.
    ///
    /// # Errors
    /// [`EvalError`] when it has none.
    pub(super) fn check(&self, names: &[String]) -> Result<(), EvalError> {
        if names.iter().any(|name| self.find(name).is_ok()) {
            return Ok(());
        }
        let judged: Vec<&str> = match self {
            Self::Road => EVALUATED.iter().map(|(_, name)| *name).collect(),
            Self::Own(own) => own.iter().map(String::as_str).take(MOST_NAMED).collect(),
        };
        let first: Vec<&str> = names.iter().map(String::as_str).take(MOST_NAMED).collect();
        Err(EvalError::new(format!(
            "the ground truth is judged by {}, and the model has none of these classes ({}): give the right names of its \
             classes (--class-names or detector.class_names), or labels of these",
            judged.join(", "),
            first.join(", ")
        )))
    }

    /// The name of a class; `class 7` if it has none.
    pub(crate) fn name(&self, class: ClassId) -> String {
        let name = match self {
            Self::Road => EVALUATED.iter().find(|(id, _)| *id == class).map(|(_, name)| *name),
            Self::Own(names) => names.get(usize::from(class.0)).map(String::as_str),
        };
        name.map_or_else(|| format!("class {}", class.0), str::to_owned)
    }
}

/// True if `name` is neither a class of BDD100K nor another name of one.
pub(super) fn is_foreign_to_bdd100k(name: &str) -> bool {
    from_name(name).is_err() && !OTHERS_OF_BDD100K.contains(&name)
}

/// Maps a class name of COCO or of any BDD100K release.
pub fn from_name(name: &str) -> Result<ClassId, LeftOut> {
    match name {
        "person" | "pedestrian" | "rider" => Ok(PERSON),
        "bicycle" | "bike" => Ok(BICYCLE),
        "car" => Ok(CAR),
        "motorcycle" | "motor" => Ok(MOTORCYCLE),
        "bus" => Ok(BUS),
        "truck" => Ok(TRUCK),
        _ => Err(LeftOut::UnmappedClass),
    }
}

/// Maps a type of KITTI tracking, in capitals or not. A cyclist's box contains rider and bicycle and counts as bicycle.
pub(crate) fn from_kitti(kind: &str) -> Result<ClassId, LeftOut> {
    match kind.to_ascii_lowercase().as_str() {
        "pedestrian" | "person" | "person_sitting" => Ok(PERSON),
        "cyclist" => Ok(BICYCLE),
        "car" | "van" => Ok(CAR),
        "truck" => Ok(TRUCK),
        _ => Err(LeftOut::UnmappedClass),
    }
}

/// Maps a class number of MOT16 or later that has boxes to be found. The 2015 release writes -1 and contains only
/// pedestrians.
pub(crate) fn from_mot_challenge(number: i64) -> Result<ClassId, LeftOut> {
    match number {
        -1 | 1 => Ok(PERSON),
        3 => Ok(CAR),
        4 => Ok(BICYCLE),
        5 => Ok(MOTORCYCLE),
        _ => Err(LeftOut::UnmappedClass),
    }
}

/// Maps a category of VisDrone.
pub(crate) fn from_visdrone(number: i64) -> Result<ClassId, LeftOut> {
    match number {
        // Pedestrian, people.
        1 | 2 => Ok(PERSON),
        3 => Ok(BICYCLE),
        // Car, van.
        4 | 5 => Ok(CAR),
        6 => Ok(TRUCK),
        9 => Ok(BUS),
        10 => Ok(MOTORCYCLE),
        _ => Err(LeftOut::UnmappedClass),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of_model(names: &[&str]) -> Evaluated {
        let names: Vec<String> = names.iter().map(|&name| name.to_owned()).collect();
        Evaluated::of_model(&names)
    }

    #[test]
    fn a_model_with_no_class_beside_the_six_is_evaluated_with_the_six() {
        assert_eq!(of_model(&["car", "rider", "bus"]), Evaluated::Road);
    }

    #[test]
    fn the_classes_of_ones_own_model_are_found_by_their_names_or_as_the_same_of_the_six() {
        let own = of_model(&["helmet", "Vest", "pedestrian"]);
        let found = ["helmet", "vest", "person", "car"].map(|name| own.find(name).ok());
        assert_eq!(
            found,
            [Some(ClassId(0)), Some(ClassId(1)), Some(ClassId(2)), None]
        );
    }

    #[test]
    fn a_class_is_called_by_its_name_or_else_by_its_number() {
        let own = of_model(&["helmet", "Vest"]);
        assert_eq!(own.name(ClassId(1)), "Vest");
        assert_eq!(own.name(ClassId(9)), "class 9");
        assert_eq!(Evaluated::Road.name(CAR), "car");
    }

    #[test]
    fn pedestrian_and_rider_are_both_mapped_to_person() {
        assert_eq!(from_name("pedestrian"), Ok(PERSON));
        assert_eq!(from_name("rider"), Ok(PERSON));
    }

    #[test]
    fn the_seven_classes_of_bdd100k_are_mapped_to_six() {
        let mapped: std::collections::BTreeSet<u16> = albireo_core::detection::BDD100K_CLASSES
            .iter()
            .map(|name| match from_name(name) {
                Ok(class) => class.0,
                other => panic!("{name} is {other:?}"),
            })
            .collect();
        assert_eq!(mapped.len(), 6);
    }

    #[test]
    fn a_class_that_is_not_evaluated_is_not_mapped() {
        assert_eq!(from_name("traffic light"), Err(LeftOut::UnmappedClass));
    }
}
