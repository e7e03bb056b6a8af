//! Defines the classes that are evaluated, and maps the names of data sets to them.
//!
//! Class numbers are COCO's, counted from 0, as detectors trained on COCO report them. The paper evaluates the
//! classes of BDD100K that COCO also has, with pedestrian and rider both taken as person: six classes.

use super::LeftOut;
use albireo_core::detection::ClassId;

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

/// Returns the name of an evaluated class; `None` for any other.
pub(crate) fn name(class: ClassId) -> Option<&'static str> {
    EVALUATED.iter().find(|(id, _)| *id == class).map(|(_, name)| *name)
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

/// Maps a type of KITTI tracking. A cyclist's box contains rider and bicycle and counts as bicycle.
pub(crate) fn from_kitti(kind: &str) -> Result<ClassId, LeftOut> {
    match kind {
        "Pedestrian" | "Person" | "Person_sitting" => Ok(PERSON),
        "Cyclist" => Ok(BICYCLE),
        "Car" | "Van" => Ok(CAR),
        "Truck" => Ok(TRUCK),
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

    #[test]
    fn pedestrian_and_rider_are_both_mapped_to_person() {
        let mapped: std::collections::BTreeSet<u16> = albireo_core::detection::BDD100K_CLASSES
            .iter()
            .map(|name| match from_name(name) {
                Ok(class) => class.0,
                other => panic!("{name} is {other:?}"),
            })
            .collect();
        assert_eq!(mapped.len(), 6);
        assert_eq!(from_name("rider"), from_name("pedestrian"));
        assert_eq!(from_name("traffic light"), Err(LeftOut::UnmappedClass));
    }
}
