//! Adds up the way of a clip, in constant memory.

use albireo_wire::{ClipTravel, MOST_TRACK_POINTS, Position};
use std::f64::consts::PI;
use std::time::Duration;
use tokio::time::Instant;

/// Radius of the Earth, metres.
const EARTH_M: f64 = 6_371_000.0;
/// The shortest step that counts, metres: the positions of a receiver that stands still wander by some metres.
const LEAST_STEP_M: f64 = 10.0;
/// Below this speed a camera stands, metres per second.
const STANDING_M_S: f64 = 0.5;
/// A faster step is an error of the receiver, metres per second.
const FASTEST_STEP_M_S: f64 = 100.0;
/// A corner of a smaller triangle is no corner, square metres: the line passes its point at a metre or two.
const LEAST_CORNER_M2: f64 = 20.0;
/// The number of points above which the track is thinned.
const MOST_POINTS: usize = 2 * MOST_TRACK_POINTS;

/// The way of an open clip.
#[derive(Clone, Debug)]
pub(super) struct Travel {
    /// The last position.
    last: Waypoint,
    /// The end of the way so far.
    end: Waypoint,
    /// A position that is too far away to be believed, unless the next one is near it.
    doubtful: Option<Waypoint>,
    distance_m: f64,
    fastest_m_s: Option<f64>,
    /// West, south, east, north; not wrapped at the antimeridian.
    bounds: [f64; 4],
    track: Vec<[f64; 2]>,
}

/// A place and the time there.
#[derive(Clone, Copy, Debug)]
struct Waypoint {
    /// Degrees; not wrapped at the antimeridian.
    longitude: f64,
    latitude: f64,
    /// By the camera's clock, nanoseconds.
    t_ns: u64,
    arrival: Instant,
}

impl Waypoint {
    /// Great-circle distance, metres (haversine formula).
    fn distance_m(&self, other: &Self) -> f64 {
        let [from, to] = [self.latitude, other.latitude].map(f64::to_radians);
        let half = |degrees: f64| (degrees.to_radians() / 2.0).sin().powi(2);
        let north = half(other.latitude - self.latitude);
        let east = half(other.longitude - self.longitude);
        let square = north + from.cos() * to.cos() * east;
        2.0 * EARTH_M * square.min(1.0).sqrt().asin()
    }

    /// True if a camera can have come here from `earlier`. A replay is faster than its camera's clock, and a camera's clock
    /// may stand still: the longer time counts.
    fn is_reachable_from(&self, earlier: &Self) -> bool {
        let by_clock = Duration::from_nanos(self.t_ns.saturating_sub(earlier.t_ns));
        let by_arrival = self.arrival.saturating_duration_since(earlier.arrival);
        let seconds = by_clock.max(by_arrival).as_secs_f64().max(1.0);
        earlier.distance_m(self) <= seconds * FASTEST_STEP_M_S
    }

    fn point(&self) -> [f64; 2] {
        [self.longitude, self.latitude]
    }
}

impl Travel {
    /// Begins at the position of a frame, with its capture time and arrival.
    pub(super) fn new(position: Position, t_ns: u64, arrival: Instant) -> Self {
        let place = Waypoint {
            longitude: position.longitude,
            latitude: position.latitude,
            t_ns,
            arrival,
        };
        let [longitude, latitude] = place.point();
        Self {
            last: place,
            end: place,
            doubtful: None,
            distance_m: 0.0,
            fastest_m_s: position.speed_m_s,
            bounds: [longitude, latitude, longitude, latitude],
            track: vec![place.point()],
        }
    }

    /// Adds the position of the next frame.
    pub(super) fn add(&mut self, position: Position, t_ns: u64, arrival: Instant) {
        // The nearer way around the Earth.
        let turn = (position.longitude - self.last.longitude + 180.0).rem_euclid(360.0) - 180.0;
        let place = Waypoint {
            longitude: self.last.longitude + turn,
            latitude: position.latitude,
            t_ns,
            arrival,
        };
        // Frames come more often than positions: the same one changes nothing.
        let newest = self.doubtful.as_ref().unwrap_or(&self.last);
        if place.point() == newest.point() {
            return;
        }
        if !place.is_reachable_from(&self.last) {
            let is_confirmed =
                self.doubtful.as_ref().is_some_and(|one| place.is_reachable_from(one));
            if !is_confirmed {
                self.doubtful = Some(place);
                return;
            }
            // It is there after all, and nobody knows how it came there.
            self.go_on_at(place);
        }
        self.doubtful = None;
        self.last = place;
        if let Some(speed) = position.speed_m_s {
            let fastest = self.fastest_m_s.unwrap_or(speed);
            self.fastest_m_s = Some(fastest.max(speed));
        }
        let [longitude, latitude] = place.point();
        let [west, south, east, north] = self.bounds;
        self.bounds = [
            west.min(longitude),
            south.min(latitude),
            east.max(longitude),
            north.max(latitude),
        ];
        let stands = position.speed_m_s.is_some_and(|speed| speed < STANDING_M_S);
        if !stands && self.end.distance_m(&place) >= LEAST_STEP_M {
            self.go_to(place);
        }
    }

    /// Lengthens the way to a place.
    fn go_to(&mut self, place: Waypoint) {
        self.distance_m += self.end.distance_m(&place);
        self.go_on_at(place);
    }

    /// Continues the way at a place, without the distance to it.
    fn go_on_at(&mut self, place: Waypoint) {
        self.end = place;
        self.track.push(place.point());
        if self.track.len() > MOST_POINTS {
            thin(&mut self.track, MOST_TRACK_POINTS);
        }
    }

    /// What the clip's report tells of it.
    pub(super) fn report(mut self) -> ClipTravel {
        if self.distance_m > 0.0 && self.last.point() != self.end.point() {
            self.go_to(self.last);
        }
        thin(&mut self.track, MOST_TRACK_POINTS);
        let wrapped = |longitude: f64| match longitude {
            -180.0..=180.0 => longitude,
            _ => (longitude + 180.0).rem_euclid(360.0) - 180.0,
        };
        // Five digits of a degree are about a metre.
        let rounded = |degrees: f64| (degrees * 1e5).round() / 1e5;
        let mut track: Vec<_> = self
            .track
            .iter()
            .map(|[longitude, latitude]| [wrapped(*longitude), *latitude].map(rounded))
            .collect();
        track.dedup();
        let [west, south, east, north] = self.bounds;
        ClipTravel {
            distance_m: self.distance_m,
            fastest_m_s: self.fastest_m_s,
            bounds: [wrapped(west), south, wrapped(east), north].map(rounded),
            track,
        }
    }
}

/// Removes points that lie on the line, and then others until at most `most` are left; each time the one that changes the line
/// least: the corner of the smallest triangle with its neighbours (Visvalingam and Whyatt 1993). First and last point stay.
fn thin(track: &mut Vec<[f64; 2]>, most: usize) {
    loop {
        let areas = track.windows(3).map(corner_m2).enumerate();
        let Some((smallest, area)) = areas.min_by(|(_, a), (_, b)| a.total_cmp(b)) else {
            return;
        };
        if area >= LEAST_CORNER_M2 && track.len() <= most {
            return;
        }
        track.remove(smallest + 1);
    }
}

/// The area of the triangle of three points, square metres.
fn corner_m2(points: &[[f64; 2]]) -> f64 {
    let degree_m = EARTH_M * PI / 180.0;
    // A degree of longitude is shorter away from the equator.
    let width = points[1][1].to_radians().cos();
    let side = |to: usize| {
        let east = (points[to][0] - points[0][0]) * width;
        [east * degree_m, (points[to][1] - points[0][1]) * degree_m]
    };
    let first = side(1);
    let second = side(2);
    (first[0] * second[1] - second[0] * first[1]).abs() / 2.0
}

#[cfg(test)]
mod tests {
    use super::*;

    const BERLIN: Position = Position {
        latitude: 52.52,
        longitude: 13.405,
        speed_m_s: None,
    };
    /// Degrees of latitude in a metre.
    const METRE: f64 = 180.0 / (PI * EARTH_M);

    /// A place this many metres north of another, passed at a speed.
    fn north_of(place: Position, metres: f64, speed_m_s: Option<f64>) -> Position {
        Position {
            latitude: place.latitude + metres * METRE,
            speed_m_s,
            ..place
        }
    }

    /// A way with one position per second of the camera's clock, all arriving at once, as in a replay.
    fn drive(positions: impl IntoIterator<Item = Position>) -> ClipTravel {
        let arrival = Instant::now();
        let mut positions = positions.into_iter().zip(1_u64..);
        let (first, second) = positions.next().unwrap();
        let mut travel = Travel::new(first, second * 1_000_000_000, arrival);
        for (position, second) in positions {
            // As many frames as a camera makes in a second.
            for frame in 0..30 {
                travel.add(position, second * 1_000_000_000 + frame, arrival);
            }
        }
        assert!(travel.track.len() <= MOST_POINTS);
        let travel = travel.report();
        assert_eq!(travel.check(), Ok(()));
        travel
    }

    #[test]
    fn a_straight_kilometre_is_a_kilometre() {
        let way = (0..=100).map(|step| north_of(BERLIN, 10.0 * f64::from(step), Some(10.0)));
        let travel = drive(way);
        assert!((travel.distance_m - 1000.0).abs() < 11.0, "{travel:?}");
        assert_eq!(travel.fastest_m_s, Some(10.0));
        assert_eq!(travel.bounds, [13.405, 52.52, 13.405, 52.52899]);
        // A straight line has two points.
        assert_eq!(travel.track, [[13.405, 52.52], [13.405, 52.52899]]);
    }

    #[test]
    fn a_receiver_that_wanders_while_it_stands_adds_no_distance() {
        let wander = |second: i32, metres: f64, speed_m_s| {
            let away = f64::from((second * 7) % 9 - 4) / 4.0 * metres * METRE;
            Position {
                latitude: BERLIN.latitude + away,
                longitude: BERLIN.longitude - away,
                speed_m_s,
            }
        };
        let travel = drive((0..300).map(|second| wander(second, 4.0, None)));
        assert_eq!(travel.distance_m, 0.0, "{travel:?}");
        assert_eq!(travel.track.len(), 1, "{travel:?}");
        // With its speed it may wander further.
        let travel = drive((0..300).map(|second| wander(second, 12.0, Some(0.1))));
        assert_eq!(travel.distance_m, 0.0, "{travel:?}");
    }

    #[test]
    fn an_error_of_the_receiver_is_left_out_and_a_real_jump_restarts_the_way() {
        let north_from = |start: Position| {
            (0..10).map(move |step| north_of(start, 20.0 * f64::from(step), None))
        };
        let mut way: Vec<_> = north_from(BERLIN).collect();
        let error = Position {
            longitude: BERLIN.longitude + 1.0,
            ..BERLIN
        };
        way.insert(5, error);
        let travel = drive(way);
        assert!((travel.distance_m - 180.0).abs() < 1.0, "{travel:?}");
        let [_, _, east, _] = travel.bounds;
        assert_eq!(east, BERLIN.longitude);

        let elsewhere = Position {
            latitude: 48.0,
            longitude: 11.0,
            speed_m_s: None,
        };
        let travel = drive(north_from(BERLIN).chain(north_from(elsewhere)));
        assert!((travel.distance_m - 340.0).abs() < 1.0, "{travel:?}");
        let [west, ..] = travel.bounds;
        assert_eq!(west, elsewhere.longitude);
    }

    #[test]
    fn a_long_way_keeps_its_shape_in_sixty_points() {
        // Ten laps of a circle of a kilometre around.
        let point = |step: i32| {
            let angle = f64::from(step) * 2.0 * PI / 100.0;
            let radius_m = 1000.0 / (2.0 * PI);
            // Degrees of longitude in a metre.
            let metre_east = METRE / BERLIN.latitude.to_radians().cos();
            Position {
                latitude: BERLIN.latitude + radius_m * angle.sin() * METRE,
                longitude: BERLIN.longitude + radius_m * angle.cos() * metre_east,
                speed_m_s: Some(10.0),
            }
        };
        let travel = drive((0..=1000).map(point));
        assert!(
            (9_700.0..10_010.0).contains(&travel.distance_m),
            "{travel:?}"
        );
        assert_eq!(travel.track.len(), MOST_TRACK_POINTS);
        let [west, south, east, north] = travel.bounds;
        assert!(west < BERLIN.longitude);
        assert!(BERLIN.longitude < east);
        assert!(south < BERLIN.latitude);
        assert!(BERLIN.latitude < north);
    }

    #[test]
    fn a_way_over_the_antimeridian_has_a_small_box() {
        let point = |step: i32| {
            let mut longitude = 180.0 + f64::from(step) * 20.0 * METRE;
            if longitude > 180.0 {
                longitude -= 360.0;
            }
            Position {
                latitude: -17.0,
                longitude,
                speed_m_s: None,
            }
        };
        let travel = drive((-20..=20).map(point));
        assert!((700.0..800.0).contains(&travel.distance_m), "{travel:?}");
        let [west, _, east, _] = travel.bounds;
        assert!(west > 179.0, "{travel:?}");
        assert!(east < -179.0, "{travel:?}");
    }
}
