//! The kinds of participants, their classes and sizes.

use albireo_core::detection::ClassId;

/// A kind of participant.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Pedestrian,
    Car,
    Truck,
    Bus,
    Motorcycle { ridden: bool },
    Bicycle { ridden: bool },
}

/// The class of whoever sits on a two-wheeler.
pub(super) const RIDER: ClassId = ClassId(1);

impl Kind {
    /// Its number in [`albireo_core::detection::BDD100K_CLASSES`].
    pub(super) fn class(self) -> ClassId {
        ClassId(match self {
            Self::Pedestrian => 0,
            Self::Car => 2,
            Self::Truck => 3,
            Self::Bus => 4,
            Self::Motorcycle { .. } => 5,
            Self::Bicycle { .. } => 6,
        })
    }

    /// Largest length, width and height, metres.
    pub(super) fn size(self) -> (f32, f32, f32) {
        match self {
            Self::Pedestrian => (0.6, 0.6, 1.8),
            Self::Car => (4.9, 1.95, 1.6),
            Self::Truck => (10.0, 2.5, 3.5),
            Self::Bus => (11.8, 2.55, 3.1),
            Self::Motorcycle { .. } => (2.2, 0.8, 1.5),
            Self::Bicycle { .. } => (1.8, 0.6, 1.6),
        }
    }

    /// Whether somebody sits on it, who is an object of their own.
    pub(super) fn ridden(self) -> bool {
        matches!(
            self,
            Self::Motorcycle { ridden: true } | Self::Bicycle { ridden: true }
        )
    }

    /// Whether it belongs on a pavement rather than in a lane.
    pub(super) fn walks(self) -> bool {
        matches!(self, Self::Pedestrian | Self::Bicycle { .. })
    }
}
