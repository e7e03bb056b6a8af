//! What a picture waits for before it runs: pictures of others that are announced or likely to come, and nothing else.

use super::*;

const SIZE: PictureSize = PictureSize::new(1, 1);
/// The time between two pictures of a camera, milliseconds.
const GAP: u64 = 40;
/// The time that a run takes, milliseconds.
const RUN: u64 = 12;

/// A queue whose clock counts milliseconds from its start.
struct Line {
    queue: Queue<(), ()>,
    coming: Coming,
    start: Instant,
}

impl Line {
    fn new() -> Self {
        let coming = Coming::default();
        let mut queue = Queue::new(8, Duration::from_millis(50), coming.clone());
        queue.ran(Duration::from_millis(RUN));
        Self {
            queue,
            coming,
            start: Instant::now(),
        }
    }

    fn ask(&mut self, camera: usize, at: u64) {
        let (reply, _) = oneshot::channel();
        self.queue.push(Request {
            asker: Some(Asker(camera)),
            picture: (),
            size: SIZE,
            requested_at: self.start + Duration::from_millis(at),
            reply,
        });
    }

    /// Says that a picture of `camera` is coming.
    fn announce(&self, camera: usize) -> Announcement {
        self.coming.announce(Asker(camera), SIZE)
    }

    /// When the next run may begin.
    fn begins_at(&self) -> u64 {
        self.queue.begins_at().unwrap().duration_since(self.start).as_millis() as u64
    }

    fn run(&mut self) -> Vec<usize> {
        self.queue
            .take_batch()
            .iter()
            .filter_map(|request| request.asker)
            .map(|Asker(camera)| camera)
            .collect()
    }

    /// Lets cameras 0 and 1 ask in twelve rounds, camera 1 so much `later`.
    fn twelve_rounds(&mut self, later: u64) {
        for round in 0..12 {
            for (camera, at) in [(0, 0), (1, later)] {
                self.ask(camera, round * GAP + at);
                self.run();
            }
        }
    }
}

#[test]
fn a_lone_camera_never_waits() {
    let mut line = Line::new();
    for round in 0..3 {
        line.ask(0, round * GAP);
        assert_eq!(line.begins_at(), round * GAP);
        line.run();
    }
}

#[test]
fn a_picture_does_not_wait_for_a_camera_that_has_asked_only_once() {
    let mut line = Line::new();
    line.ask(1, 5);
    line.run();
    line.ask(0, GAP);
    assert_eq!(line.begins_at(), GAP);
}

#[test]
fn a_picture_waits_for_one_that_is_about_to_come() {
    let mut line = Line::new();
    line.twelve_rounds(5);
    let first = 12 * GAP;
    let second = first + 5;
    line.ask(0, first);
    let begins = line.begins_at();
    assert!((second..=first + RUN).contains(&begins), "{begins}");
    line.ask(1, second);
    assert_eq!(line.run(), [0, 1]);
}

#[test]
fn a_camera_that_stays_away_is_waited_for_once_and_not_again() {
    let mut line = Line::new();
    line.twelve_rounds(5);
    line.ask(0, 12 * GAP);
    assert!(line.begins_at() > 12 * GAP);
    line.run();
    line.ask(0, 13 * GAP);
    assert_eq!(line.begins_at(), 13 * GAP);
}

#[test]
fn a_picture_does_not_wait_longer_than_a_run_takes() {
    let mut line = Line::new();
    line.twelve_rounds(RUN + 3);
    line.ask(0, 12 * GAP);
    assert_eq!(line.begins_at(), 12 * GAP);
}

#[test]
fn a_picture_does_not_wait_for_a_camera_without_a_rhythm() {
    let mut line = Line::new();
    let mut at = 0;
    for gap in [7, 400, 30, 900, 5, 200, 1100, 11] {
        at += gap;
        line.ask(1, at);
        line.run();
    }
    line.ask(0, at + 1);
    assert_eq!(line.begins_at(), at + 1);
}

#[test]
fn a_picture_waits_for_one_that_is_announced() {
    let mut line = Line::new();
    let _first = line.announce(0);
    let _second = line.announce(1);
    line.ask(0, 0);
    assert_eq!(line.begins_at(), RUN);
    line.ask(1, 3);
    assert_eq!(line.begins_at(), 0);
    assert_eq!(line.run(), [0, 1]);
}

#[test]
fn a_picture_does_not_wait_for_one_of_another_size_or_one_that_was_called_off() {
    let mut line = Line::new();
    let _wide = line.coming.announce(Asker(1), PictureSize::new(2, 1));
    let called_off = line.announce(2);
    line.ask(0, 0);
    assert_eq!(line.begins_at(), RUN);
    drop(called_off);
    assert_eq!(line.begins_at(), 0);
}

#[test]
fn a_camera_may_join_a_run_that_has_room_until_it_begins() {
    let mut line = Line::new();
    assert!(!line.coming.has_room(SIZE, 2), "no run is coming");
    let _first = line.announce(0);
    assert!(line.coming.has_room(SIZE, 2));
    assert!(
        !line.coming.has_room(PictureSize::new(2, 1), 2),
        "of another size"
    );
    let second = line.announce(1);
    assert!(!line.coming.has_room(SIZE, 2), "the run is full");
    drop(second);
    line.ask(0, 0);
    assert!(line.coming.has_room(SIZE, 2), "the run has not begun");
    line.run();
    assert!(!line.coming.has_room(SIZE, 2), "the run has begun");
}

#[test]
fn a_run_may_have_one_two_four_and_so_on_or_the_most_pictures() {
    let sizes = |largest| batch_sizes(largest).collect::<Vec<_>>();
    assert_eq!(sizes(0), [1]);
    assert_eq!(sizes(1), [1]);
    assert_eq!(sizes(3), [1, 2, 3]);
    assert_eq!(sizes(8), [1, 2, 4, 8]);
    assert_eq!(sizes(12), [1, 2, 4, 8, 12]);
}

#[test]
fn a_run_has_one_of_the_numbers_of_pictures_that_the_model_was_warmed_up_with() {
    let mut line = Line::new();
    for camera in 1..8 {
        line.ask(camera, 0);
    }
    assert_eq!(line.run(), [1, 2, 3, 4]);
    assert_eq!(line.run(), [5, 6]);
    assert_eq!(line.run(), [7]);
}
