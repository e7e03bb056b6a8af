//! Promises of the sum of meters.

use super::*;
use std::sync::Mutex;

/// What a meter will read next: the rule of its total, and its domains. `None` to fail.
type Next = Arc<Mutex<Option<(&'static str, Vec<(Domain, Value)>)>>>;

/// A meter that reads what it is told to.
struct Told {
    name: &'static str,
    next: Next,
}

fn told(
    name: &'static str,
    rule: &'static str,
    values: &[(Domain, Value)],
) -> (Box<dyn Meter>, Next) {
    let next = Arc::new(Mutex::new(Some((rule, values.to_vec()))));
    let meter = Told {
        name,
        next: Arc::clone(&next),
    };
    (Box::new(meter), next)
}

impl Meter for Told {
    fn source(&self) -> &str {
        self.name
    }

    fn quality(&self) -> EnergyQuality {
        EnergyQuality::Measured
    }

    fn poll(&mut self, _now: Instant) -> Result<Vec<Reading>, MeterError> {
        let next = self.next.lock().unwrap();
        let Some((rule, told)) = &*next else {
            return Err(MeterError::Failed(format!("{} is gone", self.name)));
        };
        let mut values = Values::default();
        for (domain, value) in told {
            values.set(*domain, *value);
        }
        let rail = Rail {
            name: "all".into(),
            domain: None,
            in_total: true,
            value: values.get(Domain::Total),
        };
        Ok(vec![Reading {
            at: None,
            values,
            total_from: (*rule).into(),
            rails: vec![rail],
        }])
    }
}

fn read(sum: &mut SumMeter) -> Reading {
    sum.poll(Instant::now()).unwrap().remove(0)
}

const J: fn(f64) -> Value = Value::counter;
const W: fn(f64) -> Value = Value::power;

#[test]
fn processor_and_cards_add_up_to_the_total() {
    let processor = [
        (Domain::Total, J(35.0)),
        (Domain::Cpu, J(26.0)),
        (Domain::Gpu, J(4.0)),
    ];
    let (rapl, _) = told("rapl", "sum_of_rails", &processor);
    let (nvml, _) = told(
        "nvml",
        "cards",
        &[(Domain::Total, J(100.0)), (Domain::Gpu, J(100.0))],
    );
    let mut sum = SumMeter::new(vec![rapl, nvml]).unwrap();
    let found = read(&mut sum);
    assert_eq!(found.values.get(Domain::Total), J(135.0));
    assert_eq!(found.values.get(Domain::Gpu), J(104.0));
    assert_eq!(found.values.get(Domain::Cpu), J(26.0));
    assert_eq!(&*found.total_from, "sum_of_rails of rapl and nvml");
    assert_eq!(sum.source(), "sum(rapl+nvml)");
    assert_eq!(&*found.rails[1].name, "nvml: all");
}

#[test]
fn a_meter_of_the_whole_machine_is_not_added_to_its_parts() {
    let (rapl, _) = told(
        "rapl",
        "sum_of_rails",
        &[(Domain::Total, J(35.0)), (Domain::Cpu, J(35.0))],
    );
    let (battery, _) = told("battery", INPUT_RAIL, &[(Domain::Total, W(12.0))]);
    let mut sum = SumMeter::new(vec![rapl, battery]).unwrap();
    let found = read(&mut sum);
    assert_eq!(found.values.get(Domain::Total), W(12.0));
    assert_eq!(found.values.get(Domain::Cpu), J(35.0));
    assert_eq!(&*found.total_from, "input_rail of battery");
    let in_total: Vec<bool> = found.rails.iter().map(|r| r.in_total).collect();
    assert_eq!(in_total, [false, true]);
}

#[test]
fn a_total_of_which_a_part_fails_is_left_out_and_not_too_small() {
    let (rapl, _) = told(
        "rapl",
        "sum_of_rails",
        &[(Domain::Total, J(35.0)), (Domain::Cpu, J(35.0))],
    );
    let (nvml, cards) = told(
        "nvml",
        "cards",
        &[(Domain::Total, W(100.0)), (Domain::Gpu, W(100.0))],
    );
    let mut sum = SumMeter::new(vec![rapl, nvml]).unwrap();
    *cards.lock().unwrap() = None;
    let found = read(&mut sum);
    assert_eq!(found.values.get(Domain::Total), Value::default());
    assert_eq!(found.values.get(Domain::Gpu), Value::default());
    assert_eq!(found.values.get(Domain::Cpu), J(35.0));
}

#[test]
fn when_all_fail_the_sum_fails() {
    let (rapl, next) = told("rapl", "sum_of_rails", &[(Domain::Total, J(35.0))]);
    let mut sum = SumMeter::new(vec![rapl]).unwrap();
    *next.lock().unwrap() = None;
    let text = sum.poll(Instant::now()).unwrap_err().to_string();
    assert!(text.contains("rapl is gone"), "{text}");
}
