//! What stands where beside the road: drawn cell by cell from the clip's seed.

use super::random::{Random, mix};
use super::road::{HORIZON, Road, Setting};

/// One thing beside the road.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Item {
    Tree,
    Conifer,
    Bush,
    Post,
    Pole,
    Lamp,
    Sign,
    House,
    Building,
    Bin,
    Bale,
    /// A piece of guard rail, its length in metres.
    Rail(f32),
    /// A board over or beside a highway.
    Board,
    Bridge,
}

/// An item at its place.
#[derive(Clone, Copy, Debug)]
pub(super) struct Placed {
    pub item: Item,
    pub along: f32,
    pub across: f32,
    /// Decides its looks.
    pub seed: u64,
}

/// Says what, if anything, stands in the cell that begins at a place along the road, and where across it.
type Place<'a> = &'a mut dyn FnMut(f32, &mut Random) -> Option<(Item, f32)>;

/// Everything beside `road` between `from` and `to`.
pub(super) fn items(road: &Road, seed: u64, from: f32, to: f32) -> Vec<Placed> {
    let mut found = Vec::with_capacity(160);
    let mut every = |step: f32, purpose: u64, place: Place| {
        let first = (from / step).floor() as i64;
        let last = (to / step).ceil() as i64;
        for cell in first..=last {
            let seed = mix(&[seed, purpose, cell as u64]);
            let mut random = Random::new(&[seed]);
            let along = cell as f32 * step;
            if let Some((item, across)) = place(along, &mut random) {
                found.push(Placed {
                    item,
                    along,
                    across,
                    seed,
                });
            }
        }
    };
    let clear = |along: f32, margin: f32| !road.near_junction(along, margin);
    match road.setting {
        Setting::Country => {
            let wooded = |along: f32| mix(&[seed, 40, (along / 90.0).floor() as i64 as u64]) % 3;
            for side in [-1.0, 1.0] {
                let purpose = if side > 0.0 { 100 } else { 200 };
                for row in 0..2 {
                    every(8.0, purpose + row, &mut |along, random| {
                        let share = [0.12, 0.45, 0.85][wooded(along) as usize];
                        let item = random.pick([Item::Tree, Item::Tree, Item::Conifer, Item::Bush]);
                        let across = random.range(8.0, 16.0) + row as f32 * 14.0;
                        (random.chance(share) && clear(along, 11.0))
                            .then_some((item, side * across))
                    });
                }
                every(25.0, purpose + 3, &mut |along, _| {
                    (!road.rails && clear(along, 6.0)).then_some((Item::Post, side * 5.1))
                });
                every(6.0, purpose + 4, &mut |along, _| {
                    (road.rails && clear(along, 13.0)).then_some((Item::Rail(6.0), side * 6.0))
                });
                every(70.0, purpose + 5, &mut |along, random| {
                    let item = random.pick([Item::House, Item::Bale, Item::Sign]);
                    let across = match item {
                        Item::House => random.range(20.0, 34.0),
                        Item::Bale => random.range(12.0, 26.0),
                        _ => 6.0,
                    };
                    (random.chance(0.5) && clear(along, 14.0)).then_some((item, side * across))
                });
            }
            every(45.0, 300, &mut |along, _| {
                clear(along, 6.0).then_some((Item::Pole, -11.5))
            });
        }
        Setting::Highway => {
            for side in [-1.0, 1.0] {
                let purpose = if side > 0.0 { 100 } else { 200 };
                every(8.0, purpose, &mut |_, random| {
                    let item = random.pick([Item::Tree, Item::Conifer, Item::Bush, Item::Tree]);
                    random
                        .chance(0.45)
                        .then_some((item, side * random.range(24.0, 46.0)))
                });
                every(6.0, purpose + 1, &mut |_, _| {
                    Some((Item::Rail(6.0), side * 16.4))
                });
                every(50.0, purpose + 2, &mut |_, _| {
                    Some((Item::Post, side * 15.8))
                });
            }
            every(6.0, 300, &mut |_, _| Some((Item::Rail(6.0), 0.0)));
            every(240.0, 301, &mut |_, random| {
                let item = random.pick([Item::Bridge, Item::Board, Item::Board]);
                random
                    .chance(0.7)
                    .then_some((item, if item == Item::Bridge { 0.0 } else { 19.0 }))
            });
            every(40.0, 302, &mut |_, _| Some((Item::Lamp, 0.4)));
        }
        Setting::Town => {
            for side in [-1.0, 1.0] {
                let purpose = if side > 0.0 { 100 } else { 200 };
                every(12.0, purpose, &mut |along, random| {
                    (clear(along, 10.0) && random.chance(0.92))
                        .then_some((Item::Building, side * 10.2))
                });
                every(27.0, purpose + 1, &mut |along, _| {
                    clear(along + side * 6.0, 6.0).then_some((Item::Lamp, side * 6.5))
                });
                every(11.0, purpose + 2, &mut |along, random| {
                    (clear(along, 9.0) && random.chance(0.28)).then_some((Item::Tree, side * 6.9))
                });
                every(19.0, purpose + 3, &mut |along, random| {
                    let item = random.pick([Item::Bin, Item::Sign, Item::Bin]);
                    (clear(along, 8.0) && random.chance(0.4)).then_some((item, side * 6.7))
                });
            }
        }
    }
    found
}

/// How far an item is drawn, metres.
pub(super) fn reach(item: Item) -> f32 {
    match item {
        Item::Bush | Item::Bin | Item::Bale => 110.0,
        Item::Post | Item::Sign => 130.0,
        Item::Rail(_) => 170.0,
        _ => HORIZON - 15.0,
    }
}
