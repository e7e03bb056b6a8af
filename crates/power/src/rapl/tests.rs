//! Promises of the RAPL counters, on powercap trees in the layout of the kernel's documentation.

use super::*;
use crate::tests::Tree;
use rstest::rstest;

const PACKAGE: &str = "intel-rapl:0";
const FIRST: &str = "intel-rapl:0/intel-rapl:0:0";
const SECOND: &str = "intel-rapl:0/intel-rapl:0:1";
const OTHER: &str = "intel-rapl:1";
const DRAM: &str = "intel-rapl:1/intel-rapl:1:0";
const MMIO: &str = "intel-rapl-mmio:0";

/// Where the counters wrap, microjoules.
const RANGE: u64 = 262_143_328_850;

fn set(tree: &Tree, zones: &[(&str, &str, u64, u64)], later: bool) {
    for (zone, name, before, after) in zones {
        tree.rapl(zone, name, if later { *after } else { *before });
    }
}

/// Joules of the total, GPU, CPU and memory within a second in which counters rose: path, name, counts before and after.
#[rstest]
#[case::subzones_and_the_mmio_duplicate_are_not_added_to_the_package(
    &[
        (PACKAGE, "package-0", 1_000_000, 31_000_000),
        (FIRST, "core", 500_000, 20_500_000),
        (SECOND, "uncore", 100_000, 4_100_000),
        (MMIO, "package-0", 1_000_000, 31_000_000),
    ],
    [Some(30.0), Some(4.0), Some(26.0), None],
    "sum_of_rails",
)]
#[case::two_sockets_and_their_memory_add_up(
    &[
        (PACKAGE, "package-0", 0, 10_000_000),
        (FIRST, "dram", 0, 2_000_000),
        (OTHER, "package-1", 0, 20_000_000),
        (DRAM, "dram", 0, 3_000_000),
    ],
    [Some(35.0), None, Some(30.0), Some(5.0)],
    "sum_of_rails",
)]
#[case::psys_is_the_whole_platform_and_packages_are_not_added_to_it(
    &[(PACKAGE, "package-0", 0, 10_000_000), (OTHER, "psys", 0, 25_000_000)],
    [Some(25.0), None, Some(10.0), None],
    "input_rail",
)]
#[case::only_the_mmio_zone_is_used_where_there_is_no_other(
    &[(MMIO, "package-0", 0, 3_000_000)],
    [Some(3.0), None, Some(3.0), None],
    "sum_of_rails",
)]
#[case::a_counter_that_wraps_goes_on_counting(
    &[(PACKAGE, "package-0", RANGE - 4_000_000, 6_000_000)],
    [Some(10.0), None, Some(10.0), None],
    "sum_of_rails",
)]
#[case::a_counter_that_was_reset_is_not_taken_for_one_that_wrapped(
    &[(PACKAGE, "package-0", 5_000_000_000, 1_000_000)],
    [Some(0.0), None, Some(0.0), None],
    "sum_of_rails",
)]
fn the_domains_of(
    #[case] zones: &[(&str, &str, u64, u64)],
    #[case] joules: [Option<f64>; 4],
    #[case] total_from: &str,
) {
    let tree = Tree::default();
    set(&tree, zones, false);
    let mut meter = Rapl::open(&tree.config()).unwrap();
    let start = Instant::now();
    meter.poll(start).unwrap();
    set(&tree, zones, true);
    let later = start + Duration::from_secs(1);
    let reading = meter.poll(later).unwrap().remove(0);
    assert_eq!(
        reading.values,
        joules.map(|joules| joules.map(Value::Counter))
    );
    assert_eq!(&*reading.total_from, total_from);
}

#[test]
fn a_machine_without_powercap_says_what_was_looked_for() {
    let text = Rapl::open(&Tree::default().config())
        .unwrap_err()
        .to_string();
    assert!(
        text.contains("class/powercap") && text.contains("intel_rapl_msr"),
        "{text}"
    );
}

#[test]
fn a_psys_counter_that_counts_less_than_its_packages_is_not_believed() {
    let tree = Tree::default();
    set(
        &tree,
        &[(PACKAGE, "package-0", 0, 0), (OTHER, "psys", 0, 0)],
        false,
    );
    let mut zones = find(&tree.path("sys/class/powercap")).unwrap();
    let start = Instant::now();
    read(&mut zones, start).unwrap();
    for (second, psys, believed) in [(1, 150_000, false), (2, 12_000_000, true)] {
        tree.rapl(PACKAGE, "package-0", 10_000_000);
        tree.rapl(OTHER, "psys", psys);
        read(&mut zones, start + Duration::from_secs(second)).unwrap();
        assert_eq!(includes_its_parts(&zones), believed);
    }
}
