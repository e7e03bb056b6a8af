//! Tests of the NVML meter, on fake cards.

use super::*;
use std::sync::Mutex;
use std::time::Duration;

/// The answers of one card.
#[derive(Clone)]
struct Fake {
    energy: Result<Option<u64>, String>,
    power: Result<Option<u32>, String>,
}

#[derive(Clone)]
struct FakeMachine(Arc<Mutex<Vec<Fake>>>);

impl FakeMachine {
    fn new(cards: &[Fake]) -> Self {
        Self(Arc::new(Mutex::new(cards.to_vec())))
    }

    fn set(&self, card: usize, fake: Fake) {
        self.0.lock().unwrap()[card] = fake;
    }

    fn open(&self) -> Nvml {
        Nvml::with(Box::new(self.clone())).unwrap()
    }

    fn refused(&self) -> String {
        let refused = Nvml::with(Box::new(self.clone())).err();
        refused.unwrap().to_string()
    }
}

impl Cards for FakeMachine {
    fn count(&self) -> Result<u32, String> {
        Ok(self.0.lock().unwrap().len() as u32)
    }

    fn name(&self, _card: u32) -> Option<String> {
        Some("Test GPU".to_owned())
    }

    fn energy_mj(&self, card: u32) -> Result<Option<u64>, String> {
        self.0.lock().unwrap()[card as usize].energy.clone()
    }

    fn power_mw(&self, card: u32) -> Result<Option<u32>, String> {
        self.0.lock().unwrap()[card as usize].power.clone()
    }

    fn condition(&self, card: u32) -> Condition {
        Condition {
            hottest: Some(("gpu".into(), 40.0 + f64::from(card))),
            throttled: Some(card == 1),
            ..Condition::default()
        }
    }
}

fn card(energy: Option<u64>, power: Option<u32>) -> Fake {
    let (energy, power) = (Ok(energy), Ok(power));
    Fake { energy, power }
}

fn counting(mj: u64) -> Fake {
    card(Some(mj), Some(1))
}

fn jetson() -> Fake {
    card(None, None)
}

/// The second reading, 1 s after the first; the first card becomes `next` in between.
fn second_reading(machine: &FakeMachine, next: Fake) -> Reading {
    let mut meter = machine.open();
    let start = Instant::now();
    meter.poll(start).unwrap();
    machine.set(0, next);
    let later = start + Duration::from_secs(1);
    meter.poll(later).unwrap().remove(0)
}

#[test]
fn energy_counters_are_used_if_every_card_has_one() {
    let machine = FakeMachine::new(&[counting(5_000), counting(7_000)]);
    let reading = second_reading(&machine, counting(65_000));
    let total = reading.value(Domain::Total);
    assert_eq!(total, Some(Value::Counter(60.0)));
    assert_eq!(reading.value(Domain::Gpu), total);
    assert_eq!(reading.value(Domain::Cpu), None);
}

#[test]
fn power_is_used_for_a_card_without_an_energy_counter() {
    let machine = FakeMachine::new(&[counting(5_000), card(None, Some(75_500))]);
    let mut meter = machine.open();
    let reading = meter.poll(Instant::now()).unwrap().remove(0);
    assert_eq!(
        reading.value(Domain::Total),
        Some(Value::Power(0.001 + 75.5))
    );
}

#[test]
fn no_card_with_a_power_reading_is_an_error() {
    let text = FakeMachine::new(&[jetson()]).refused();
    assert!(text.contains("no card reports its power"), "{text}");
    assert!(text.contains("ina or tegrastats"), "{text}");
    let text = FakeMachine::new(&[]).refused();
    assert!(text.contains("no card"), "{text}");
}

#[test]
fn a_card_without_readings_is_left_out() {
    let meter = FakeMachine::new(&[jetson(), counting(0)]).open();
    assert_eq!(meter.cards.len(), 1);
    assert_eq!(&*meter.cards[0].name, "1 Test GPU");
}

#[test]
fn a_lost_card_is_an_error_rather_than_zero() {
    let machine = FakeMachine::new(&[counting(0), counting(0)]);
    let mut meter = machine.open();
    meter.poll(Instant::now()).unwrap();
    let lost = "GPU is lost".to_owned();
    let (energy, power) = (Err(lost.clone()), Err(lost));
    machine.set(1, Fake { energy, power });
    let text = meter.poll(Instant::now()).unwrap_err().to_string();
    assert!(
        text.contains("card 1") && text.contains("GPU is lost"),
        "{text}"
    );
}

#[test]
fn a_driver_reload_does_not_decrease_the_energy() {
    let machine = FakeMachine::new(&[counting(9_000_000)]);
    let reading = second_reading(&machine, counting(10));
    assert_eq!(reading.value(Domain::Total), Some(Value::Counter(0.0)));
}

#[test]
fn the_condition_has_the_hottest_card_and_any_throttling() {
    let mut meter = FakeMachine::new(&[counting(0), counting(0)]).open();
    let found = meter.condition();
    assert_eq!(found.hottest, Some(("gpu".into(), 41.0)));
    assert_eq!(found.throttled, Some(true));
}

#[test]
fn a_missing_driver_is_reported_with_the_reason() {
    let error = driver::Driver::load(&["/nowhere/libnvidia-ml.so.1"]).err();
    let text = missing(error.unwrap()).to_string();
    assert_eq!(
        text,
        "nvml: not on this machine: no NVIDIA driver: libnvidia-ml.so.1 cannot be loaded"
    );
}
