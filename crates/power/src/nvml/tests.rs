//! Promises of the NVML meter, on cards that are not there.

use super::*;
use std::sync::Mutex;
use std::time::Duration;

/// What one card says.
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

/// The reading a second after the first, before which the first card becomes `next`.
fn second_reading(machine: &FakeMachine, next: Fake) -> Reading {
    let mut meter = machine.open();
    let start = Instant::now();
    meter.poll(start).unwrap();
    machine.set(0, next);
    let later = start + Duration::from_secs(1);
    meter.poll(later).unwrap().remove(0)
}

#[test]
fn the_energy_counters_are_used_where_all_cards_have_one() {
    let machine = FakeMachine::new(&[counting(5_000), counting(7_000)]);
    let reading = second_reading(&machine, counting(65_000));
    let total = reading.value(Domain::Total);
    assert_eq!(total, Some(Value::Counter(60.0)));
    assert_eq!(reading.value(Domain::Gpu), total);
    assert_eq!(reading.value(Domain::Cpu), None);
}

#[test]
fn power_is_used_where_a_card_counts_no_energy() {
    let machine = FakeMachine::new(&[counting(5_000), card(None, Some(75_500))]);
    let mut meter = machine.open();
    let reading = meter.poll(Instant::now()).unwrap().remove(0);
    assert_eq!(
        reading.value(Domain::Total),
        Some(Value::Power(0.001 + 75.5))
    );
}

#[test]
fn a_driver_that_says_not_supported_to_every_power_call_is_no_meter() {
    let text = FakeMachine::new(&[jetson()]).refused();
    assert!(text.contains("no card reports its power"), "{text}");
    assert!(text.contains("ina or tegrastats"), "{text}");
    let text = FakeMachine::new(&[]).refused();
    assert!(text.contains("no card"), "{text}");
}

#[test]
fn a_card_that_reports_nothing_is_left_out_beside_one_that_does() {
    let meter = FakeMachine::new(&[jetson(), counting(0)]).open();
    assert_eq!(meter.cards.len(), 1);
    assert_eq!(&*meter.cards[0].name, "1 Test GPU");
}

#[test]
fn a_card_that_falls_off_the_bus_is_an_error_and_not_zero() {
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
fn a_driver_that_was_reloaded_does_not_take_energy_back() {
    let machine = FakeMachine::new(&[counting(9_000_000)]);
    let reading = second_reading(&machine, counting(10));
    assert_eq!(reading.value(Domain::Total), Some(Value::Counter(0.0)));
}

#[test]
fn the_condition_is_that_of_the_hottest_card_and_throttling_of_any() {
    let mut meter = FakeMachine::new(&[counting(0), counting(0)]).open();
    let found = meter.condition();
    assert_eq!(found.hottest, Some(("gpu".into(), 41.0)));
    assert_eq!(found.throttled, Some(true));
}

#[test]
fn without_a_driver_the_reason_is_given() {
    let error = driver::Driver::load(&["/nowhere/libnvidia-ml.so.1"]).err();
    let text = missing(error.unwrap()).to_string();
    assert_eq!(
        text,
        "nvml: not on this machine: no NVIDIA driver: libnvidia-ml.so.1 cannot be loaded"
    );
}
