use super::*;
use crate::tests::assert_contains;
use std::sync::Mutex;
use std::time::Duration;

/// What a card answers with.
#[derive(Clone)]
struct Shown {
    energy_mj: Option<u64>,
    power_mw: Option<u32>,
}

/// A card; an error for a lost one.
type Fake = Result<Shown, String>;

#[derive(Clone)]
struct FakeMachine(Arc<Mutex<Vec<Fake>>>);

impl FakeMachine {
    fn new(cards: Vec<Fake>) -> Self {
        Self(Arc::new(Mutex::new(cards)))
    }

    fn card(&self, card: u32) -> Fake {
        self.0.lock().unwrap()[card as usize].clone()
    }

    fn open(&self) -> Result<Nvml, MeterError> {
        Nvml::with(Box::new(self.clone()), 0)
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
        self.card(card).map(|shown| shown.energy_mj)
    }

    fn power_mw(&self, card: u32) -> Result<Option<u32>, String> {
        self.card(card).map(|shown| shown.power_mw)
    }

    fn condition(&self, card: u32) -> BoardState {
        BoardState {
            hottest_celsius: Some(40.0 + f64::from(card)),
            throttled: Some(card == 1),
            gpu_utilisation: Some(0.25 * f64::from(card)),
            ..BoardState::default()
        }
    }
}

const JETSON: Fake = Ok(Shown {
    energy_mj: None,
    power_mw: None,
});

/// A card that counts energy and draws 1 mW.
fn counting(energy_mj: u64) -> Fake {
    Ok(Shown {
        energy_mj: Some(energy_mj),
        power_mw: Some(1),
    })
}

/// A card that shows its power and counts nothing.
fn without_counter(power_mw: u32) -> Fake {
    Ok(Shown {
        energy_mj: None,
        power_mw: Some(power_mw),
    })
}

/// The second reading comes 1 s after the first; the first card becomes `next` in between.
#[rstest::rstest]
#[case::counters_are_used_if_every_card_has_one(
    vec![counting(5_000), counting(7_000)], counting(65_000), Value::Counter(60.0)
)]
#[case::power_is_used_if_a_card_has_no_counter(
    vec![counting(5_000), without_counter(75_500)], counting(6_000), Value::Power(0.001 + 75.5)
)]
#[case::a_driver_reload_does_not_decrease_the_energy(
    vec![counting(9_000_000)], counting(10), Value::Counter(0.0)
)]
fn the_cards_make_one_reading(#[case] cards: Vec<Fake>, #[case] next: Fake, #[case] sum: Value) {
    let machine = FakeMachine::new(cards);
    let mut meter = machine.open().unwrap();
    let start = Instant::now();
    meter.poll(start).unwrap();
    machine.0.lock().unwrap()[0] = next;
    let readings = meter.poll(start + Duration::from_secs(1)).unwrap();
    let expected = Values {
        total: Some(sum),
        gpu: Some(sum),
        ..Values::default()
    };
    assert_eq!(readings[0].values, expected);
    assert_eq!(
        meter.quality(),
        EnergyQuality::Partial,
        "the processor is not read"
    );
}

#[test]
fn a_card_without_readings_is_left_out_and_no_other_card_is_an_error() {
    let meter = FakeMachine::new(vec![JETSON, counting(0)]).open().unwrap();
    let names: Vec<_> = meter.cards.iter().map(|card| &*card.energy.name).collect();
    assert_eq!(names, ["1 Test GPU"]);
    let refused = |cards| FakeMachine::new(cards).open().err().unwrap();
    let parts = ["no card reports its power", "ina or tegrastats"];
    assert_contains(refused(vec![JETSON]), &parts);
    assert_contains(refused(Vec::new()), &["no card"]);
}

#[test]
fn the_condition_has_the_hottest_card_and_any_throttling_and_a_lost_card_is_an_error() {
    let machine = FakeMachine::new(vec![counting(0), counting(0)]);
    let mut meter = machine.open().unwrap();
    let found = meter.condition();
    assert_eq!(found.hottest_celsius, Some(41.0));
    assert_eq!(found.throttled, Some(true));
    assert_eq!(found.gpu_utilisation, Some(0.25));
    meter.poll(Instant::now()).unwrap();
    machine.0.lock().unwrap()[1] = Err("GPU is lost".to_owned());
    let error = meter.poll(Instant::now()).unwrap_err();
    assert_contains(error, &["card 1", "GPU is lost"]);
}

#[test]
fn a_missing_driver_is_reported_with_the_reason() {
    let error = driver::load(Path::new("/nowhere/libnvidia-ml.so.1")).err();
    let expected = "no NVIDIA driver: /nowhere/libnvidia-ml.so.1 cannot be loaded";
    assert_eq!(error.unwrap(), expected);
}
