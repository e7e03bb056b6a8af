//! The colours of vehicles.

use super::random::Random;
use super::space::{Color, scale_color};

/// Rubber.
pub(super) const TYRE: Color = [0.07, 0.07, 0.08];
/// A tail lamp.
pub(super) const TAIL: Color = [0.95, 0.12, 0.08];
/// A headlamp.
pub(super) const HEAD: Color = [1.0, 0.97, 0.86];

/// A colour cars are sold in.
pub(super) fn paintwork(random: &mut Random) -> Color {
    let color = random.pick([
        [0.85, 0.86, 0.88],
        [0.92, 0.92, 0.92],
        [0.62, 0.64, 0.66],
        [0.36, 0.38, 0.41],
        [0.14, 0.14, 0.16],
        [0.10, 0.11, 0.14],
        [0.62, 0.10, 0.09],
        [0.12, 0.22, 0.48],
        [0.14, 0.32, 0.22],
        [0.66, 0.55, 0.36],
        [0.78, 0.46, 0.12],
        [0.30, 0.48, 0.66],
    ]);
    scale_color(color, random.range(0.85, 1.1))
}
