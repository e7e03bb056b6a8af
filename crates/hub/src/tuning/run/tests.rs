mod chances;
mod fleets;
mod trials;

use super::super::metric::{BeforeAfter, Figure, Figures, Mean};
use super::super::plan::{RolloutPlan, StageSize};
use super::values::DueValue;
use super::*;
use crate::presence::reported;
use albireo_wire::Threshold;
use std::collections::BTreeMap;

pub(super) fn old() -> Threshold {
    Threshold::new("u", 3e-4)
}

pub(super) fn new() -> Threshold {
    Threshold::new("u", 5e-4)
}

/// Five clips with that mean.
pub(super) fn clips(mean: f64) -> Mean {
    let sum = 5.0 * mean;
    Mean { clips: 5, sum }
}

fn in_windows(windows: &[BeforeAfterWindows], clips: impl Fn(&Window) -> Figures) -> Measured {
    let mut measured = Measured::new();
    for one in windows {
        let figures = BeforeAfter {
            before: clips(&one.before),
            after: clips(&one.after),
        };
        measured.insert(one.after.node.clone(), figures);
    }
    measured
}

const SECOND: Millis = 1_000;

#[derive(Clone, Copy)]
struct Desired {
    revision: u64,
    threshold: Threshold,
}

#[derive(Clone)]
struct SimNode {
    reachable: bool,
    revision: u64,
    has: Threshold,
    refused: Option<u64>,
    desired: Option<Desired>,
    refuses: bool,
    /// True if the new value kills it.
    dies: bool,
    /// Energy of a clip under the new value, relative to the old.
    factor: f64,
}

/// A fleet that applies what it is given, and a hub that gives it.
#[derive(Clone, Default)]
struct World {
    nodes: BTreeMap<String, SimNode>,
    revision: u64,
    now: Millis,
    /// The most nodes that had the new value at the same time.
    most_new: usize,
}

impl World {
    fn new(count: usize) -> Self {
        let node = SimNode {
            reachable: true,
            revision: 0,
            has: old(),
            refused: None,
            desired: None,
            refuses: false,
            dies: false,
            factor: 0.9,
        };
        let nodes = (0..count).map(|i| (format!("cam-{i:03}"), node.clone())).collect();
        Self {
            nodes,
            ..Self::default()
        }
    }

    fn candidates(&self) -> Vec<Member> {
        self.nodes
            .iter()
            .map(|(name, node)| Member::new(name.clone(), old(), node.reachable))
            .collect()
    }

    /// One of the nodes, for any number.
    fn node(&mut self, i: usize) -> &mut SimNode {
        let place = i % self.nodes.len();
        self.nodes.values_mut().nth(place).unwrap()
    }

    fn have(&self, threshold: Threshold) -> usize {
        self.nodes.values().filter(|n| n.has == threshold).count()
    }

    /// Advances by 1 s.
    fn step(&mut self, rollout: &mut Run) {
        self.now += SECOND;
        for due in rollout.due() {
            self.revision += 1;
            for name in &due.nodes {
                if let Some(node) = self.nodes.get_mut(name) {
                    node.desired = Some(Desired {
                        revision: self.revision,
                        threshold: due.threshold,
                    });
                }
            }
            rollout.given(&due, self.revision, self.now);
        }
        for node in self.nodes.values_mut().filter(|n| n.reachable) {
            match node.desired {
                Some(desired) if node.refuses => node.refused = Some(desired.revision),
                Some(desired) if desired.revision > node.revision => {
                    node.revision = desired.revision;
                    node.has = desired.threshold;
                }
                _ if node.dies && node.has == new() => node.reachable = false,
                _ => {}
            }
        }
        self.most_new = self.most_new.max(self.have(new()));
        rollout.observe(self.now, |name| {
            let node = self.nodes.get(name)?;
            let mut view = reported(node.revision, node.has);
            if let Some(revision) = node.refused {
                view = view.refusing(revision);
            }
            if node.reachable {
                Some(view)
            } else {
                Some(view.silent())
            }
        });
        if let Some(windows) = rollout.tick(self.now) {
            for BeforeAfterWindows { before, after } in &windows {
                assert_eq!(before.value, old().value.to_string());
                assert!(before.from_ms < before.until_ms);
                assert!(before.until_ms <= after.from_ms);
                assert!(after.from_ms <= after.until_ms);
            }
            let found = in_windows(&windows, |window| self.clips(window));
            rollout.measured(&found, self.now);
        }
    }

    fn clips(&self, window: &Window) -> Figures {
        let factor = if window.value == new().value.to_string() {
            self.nodes[&window.node].factor
        } else {
            1.0
        };
        // Each node has its own level.
        let number: f64 = window.node["cam-".len()..].parse().unwrap();
        [
            (Figure::SkipRate, clips(0.5)),
            (Figure::JoulesMeasured, clips((100.0 + number) * factor)),
            (Figure::LatencyP99, clips(20.0)),
            (Figure::Degraded, clips(0.0)),
        ]
        .into()
    }

    fn run(&mut self, rollout: &mut Run, seconds: usize) {
        for _ in 0..seconds {
            self.step(rollout);
        }
    }

    fn run_until(&mut self, rollout: &mut Run, phase: &str) {
        for _ in 0..100_000 {
            if rollout.phase.name() == phase {
                return;
            }
            self.step(rollout);
        }
        panic!("never {phase}: {:?} {:#?}", rollout.phase, rollout.record);
    }

    fn begin(&self, plan: RolloutPlan) -> Run {
        let kind = Kind::Rollout { to: new(), plan };
        Run::begin(kind, self.candidates(), 7, "ops", self.now).unwrap()
    }
}

fn plan() -> RolloutPlan {
    RolloutPlan {
        soak_s: 100.0,
        patience_s: 50.0,
        offline_deadline_s: 1_000.0,
        held_for_s: 600.0,
        // To all nodes; by default a tenth is left to compare with.
        stages: ["1", "10%", "50%", "100%"].map(str::to_owned).to_vec(),
        ..RolloutPlan::default()
    }
}

fn last(rollout: &Run, what: What) -> &Entry {
    rollout.record.iter().rfind(|entry| entry.what == what).unwrap()
}

fn stages_entered(rollout: &Run) -> Vec<&str> {
    rollout
        .record
        .iter()
        .filter(|e| e.what == What::Stage)
        .map(|e| e.text.as_str())
        .collect()
}

#[test]
fn a_share_is_rounded_up_to_at_least_one_node() {
    for (size, all, expected) in [
        ("10%", 30, 3),
        ("10%", 31, 4),
        ("1%", 3, 1),
        ("0.001%", 10, 1),
        ("50%", 1, 1),
        ("5", 3, 3),
        ("5", 30, 5),
        ("all", 7, 7),
        ("33.3%", 1000, 333),
    ] {
        let nodes = StageSize::of(size).map(|size| size.nodes(all));
        assert_eq!(nodes, Some(expected), "{size} of {all}");
    }
    for wrong in ["0", "0%", "101%", "-1", "1.5", "few", "nan%"] {
        assert!(StageSize::of(wrong).is_none(), "{wrong}");
    }
    assert_eq!(plan().stage_ends(40), [1, 4, 20, 40]);
    assert_eq!(plan().stage_ends(1), [1]);
    assert_eq!(plan().stage_ends(2), [1, 2]);
}

#[test]
fn a_rollout_whose_gates_pass_reaches_all_nodes_in_stages() {
    let mut world = World::new(40);
    let mut rollout = world.begin(plan());
    world.run(&mut rollout, 90);
    assert_eq!(rollout.phase.name(), "soaking");
    assert_eq!(world.have(new()), 1);
    world.run_until(&mut rollout, "done");
    let stages = ["1 node", "3 nodes", "16 nodes", "20 nodes"];
    assert_eq!(stages_entered(&rollout), stages);
    assert_eq!(world.have(new()), 40);
    // Four stages of a hundred seconds: none was shorter than its soak.
    assert!(world.now >= 400 * SECOND, "{}", world.now);
    let verdicts: Vec<_> = rollout
        .record
        .iter()
        .filter(|e| e.what == What::Judged)
        .map(|e| e.verdict)
        .collect();
    assert_eq!(verdicts.len(), 8, "half-way and at the end of each");
    // One, three and the last twenty nodes allow no estimate: they took the value and still report.
    let at_the_ends: Vec<_> = verdicts.into_iter().skip(1).step_by(2).collect();
    let alive = Some(Verdict::NotMeasured);
    assert_eq!(at_the_ends, [alive, alive, Some(Verdict::Passed), alive]);
}

#[test]
fn a_stage_that_fails_its_gate_restores_the_old_value_on_all_nodes_of_the_rollout() {
    let mut world = World::new(40);
    let mut rollout = world.begin(plan());
    for node in world.nodes.values_mut() {
        node.factor = 1.33;
    }
    world.run_until(&mut rollout, "returned");
    // The first stages have too few nodes for an estimate.
    assert_eq!(stages_entered(&rollout), ["1 node", "3 nodes", "16 nodes"]);
    assert_eq!(world.most_new, 20);
    assert_eq!(world.have(old()), 40);
    let failed = rollout.record.iter().find(|e| e.verdict == Some(Verdict::Failed)).unwrap();
    let gate = failed.gates.iter().find(|g| g.verdict == Verdict::Failed).unwrap();
    assert_eq!(gate.figure, Some(Figure::JoulesMeasured));
    assert_eq!(gate.nodes, 16);
    assert_eq!(gate.compared, 20);
    // The harm is noticed half-way, not at the end of the soak.
    assert!(world.now < 300 * SECOND, "{}", world.now);
}

#[test]
fn a_value_that_kills_nodes_is_undone_even_without_measurements() {
    for count in [6, 40] {
        let mut world = World::new(count);
        for node in world.nodes.values_mut() {
            node.dies = true;
        }
        let mut rollout = world.begin(plan());
        world.run_until(&mut rollout, "returned");
        assert_eq!(world.most_new, 1);
    }
    // Every second node dies, but not the only one of the first stage: a later stage has to notice it.
    let mut world = World::new(60);
    let mut rollout = world.begin(plan());
    for (place, member) in rollout.members.iter().enumerate() {
        world.nodes.get_mut(&member.node).unwrap().dies = place % 2 == 1;
    }
    world.run_until(&mut rollout, "returned");
    assert!(world.most_new <= 30, "{}", world.most_new);
    let text = &last(&rollout, What::Judged).text;
    assert!(text.contains("fell silent"), "{text}");
}

#[test]
fn a_last_stage_that_excludes_nodes_is_measured_against_them() {
    let mut world = World::new(40);
    let mut rollout = world.begin(RolloutPlan {
        stages: ["1", "50%"].map(str::to_owned).to_vec(),
        ..plan()
    });
    world.run_until(&mut rollout, "done");
    assert_eq!(world.have(new()), 20);
    let judged = last(&rollout, What::Judged);
    assert_eq!(judged.verdict, Some(Verdict::Passed));
    assert_eq!(judged.gates[0].compared, 20);
}

#[test]
fn a_failed_stage_is_held_for_a_decision_if_the_plan_says_so() {
    let mut world = World::new(40);
    for node in world.nodes.values_mut() {
        node.factor = 2.0;
    }
    let mut rollout = world.begin(RolloutPlan {
        on_failure: OnFailure::Hold,
        ..plan()
    });
    world.run_until(&mut rollout, "held");
    world.run(&mut rollout, 500);
    assert_eq!(rollout.phase.name(), "held");
    assert_eq!(world.have(new()), 20);
    // Of the three decisions each is tried on a copy of its own.
    let mut onward = rollout.clone();
    onward.command(Command::Next, "ops", world.now).unwrap();
    let mut onward_world = world.clone();
    onward_world.run_until(&mut onward, "done");
    assert_eq!(onward_world.have(new()), 40);
    let mut stopped = rollout.clone();
    stopped.command(Command::Stop, "ops", world.now).unwrap();
    let mut stopped_world = world.clone();
    stopped_world.run(&mut stopped, 500);
    assert_eq!(stopped.phase.name(), "stopped");
    assert_eq!(stopped_world.have(new()), 20);
    rollout.command(Command::Return, "ops", world.now).unwrap();
    world.run_until(&mut rollout, "returned");
    assert_eq!(world.have(new()), 0);
    let people: Vec<_> = rollout.record.iter().filter_map(|e| e.who.as_deref()).collect();
    assert_eq!(people, ["ops", "ops"]);
}

#[test]
fn a_stage_that_cannot_be_judged_is_held_then_undone_and_resuming_it_costs_no_error_rate() {
    let mut world = World::new(10);
    let gates = vec!["recall>=-0.02".parse().unwrap()];
    let mut rollout = world.begin(RolloutPlan { gates, ..plan() });
    world.run_until(&mut rollout, "held");
    assert_eq!(world.have(new()), 1);
    let seconds = world.now / SECOND;
    assert!((150..160).contains(&seconds), "{seconds}");
    let reason = &rollout.reason;
    assert!(reason.contains("recall>=-0.02 (not measured)"), "{reason}");
    let mut alone = world.clone();
    let mut undecided = rollout.clone();
    alone.run(&mut undecided, 400);
    assert_eq!(undecided.phase.name(), "held");
    alone.run_until(&mut undecided, "returned");
    assert_eq!(alone.have(new()), 0);
    let mut total = 0.0;
    for _ in 0..6 {
        world.run_until(&mut rollout, "held");
        let Kind::Rollout { plan, .. } = &rollout.kind else {
            panic!("a trial: {rollout:?}")
        };
        let rates = rollout.error_rates(plan);
        // Each look at each figure of each stage: at the recall, and at the nodes that fell silent.
        let figures = 2.0;
        total += rates.fail * figures * rollout.stage_count() as f64 * f64::from(LOOKS);
        rollout.command(Command::Resume, "ops", world.now).unwrap();
        assert_eq!(rollout.phase.name(), "soaking");
    }
    assert!(total > 0.049, "{total}");
    assert!(total <= 0.05, "{total}");
}

#[test]
fn unreachable_nodes_come_last_do_not_stop_the_rollout_and_are_missed_after_their_deadline() {
    let mut world = World::new(10);
    for name in ["cam-001", "cam-004"] {
        world.nodes.get_mut(name).unwrap().reachable = false;
    }
    let mut rollout = world.begin(plan());
    let held_back: Vec<_> = rollout
        .members
        .iter()
        .filter(|m| m.group == 2)
        .map(|m| m.node.as_str())
        .collect();
    for name in ["cam-001", "cam-004"] {
        assert!(held_back.contains(&name), "{held_back:?}");
    }
    world.run_until(&mut rollout, "finishing");
    assert_eq!(world.have(new()), 8);
    // One returns in time and applies the new value; the other returns too late and finds the old value.
    world.nodes.get_mut("cam-001").unwrap().reachable = true;
    world.run_until(&mut rollout, "done");
    assert_eq!(world.nodes["cam-001"].has, new());
    world.run(&mut rollout, 2);
    world.nodes.get_mut("cam-004").unwrap().reachable = true;
    world.run(&mut rollout, 2);
    assert_eq!(world.nodes["cam-004"].has, old());
    let text = &last(&rollout, What::Done).text;
    assert!(text.contains("cam-004 missed"), "{text}");
}

#[test]
fn a_stage_whose_nodes_refuse_fails_without_waiting_for_its_soak() {
    let mut world = World::new(10);
    for node in world.nodes.values_mut() {
        node.refuses = true;
    }
    let mut rollout = world.begin(plan());
    world.run_until(&mut rollout, "returned");
    assert!(world.now < 10 * SECOND, "{}", world.now);
    assert_eq!(world.most_new, 0);
}

#[test]
fn a_pause_stops_the_soak_and_all_deadlines_and_no_node_is_given_a_value() {
    let mut world = World::new(10);
    let mut rollout = world.begin(plan());
    world.run_until(&mut rollout, "soaking");
    world.run(&mut rollout, 30);
    rollout.command(Command::Pause, "ops", world.now).unwrap();
    world.run(&mut rollout, 1_000);
    assert_eq!(rollout.phase.name(), "soaking");
    assert_eq!(world.have(new()), 1);
    rollout.command(Command::Resume, "ops", world.now).unwrap();
    world.run(&mut rollout, 60);
    assert_eq!(world.have(new()), 1, "the soak has 70 s left");
    world.run(&mut rollout, 20);
    assert!(world.have(new()) > 1);

    rollout.command(Command::Next, "ops", world.now).unwrap();
    assert!(!rollout.due().is_empty());
    rollout.command(Command::Pause, "ops", world.now).unwrap();
    assert_eq!(rollout.due(), []);
    rollout.command(Command::Resume, "ops", world.now).unwrap();
    let due = rollout.due().remove(0);
    rollout.given(&due, 7, world.now);
    rollout.command(Command::Pause, "ops", world.now).unwrap();
    let unchanged = |_: &str| Some(reported(0, old()));
    let hours = 3 * 3_600_000;
    let later = world.now + hours;
    rollout.observe(later, unchanged);
    rollout.command(Command::Resume, "ops", later).unwrap();
    rollout.observe(later + 1_000, unchanged);
    assert!(!due.nodes.is_empty());
    for member in &rollout.members {
        if due.nodes.contains(&member.node) {
            assert_eq!(member.given.outcome, Outcome::Pending);
        }
    }
}

#[test]
fn after_its_end_a_rollout_only_returns_and_skips_nodes_that_were_changed_since() {
    let mut world = World::new(4);
    let mut rollout = world.begin(plan());
    assert!(rollout.command(Command::Resume, "ops", 0).is_err());
    world.run_until(&mut rollout, "done");
    use Command::{Next, Pause, Resume, Stop};
    for command in [Pause, Resume, Next, Stop] {
        let done = rollout.command(command, "ops", world.now);
        assert!(done.is_err(), "{command:?}");
    }
    rollout.leave_out(|member| member.node == "cam-003");
    rollout.command(Command::Return, "ops", world.now).unwrap();
    world.run_until(&mut rollout, "returned");
    assert_eq!(world.have(new()), 1);
    assert_eq!(world.have(old()), 3);
    let error = rollout.command(Command::Return, "ops", 0).unwrap_err();
    let expected = "a rollout that is returned does not accept `return`";
    assert_eq!(error.to_string(), expected);
}

#[test]
fn a_node_that_was_given_nothing_has_nothing_to_return_from() {
    let world = World::new(4);
    let mut rollout = world.begin(plan());
    let mut never = rollout.clone();
    never.command(Command::Return, "ops", 0).unwrap();
    assert_eq!(never.due(), []);
    assert!(never.has_returned());
    let first = rollout.due().remove(0);
    rollout.given(&first, 9, 0);
    rollout.command(Command::Return, "ops", 0).unwrap();
    let only_the_first = DueValue {
        threshold: old(),
        nodes: first.nodes,
    };
    assert_eq!(rollout.due(), [only_the_first]);
}

#[test]
fn an_invalid_plan_is_rejected_with_its_field() {
    type Change = fn(&mut RolloutPlan);
    let changes: [(&str, Change); 8] = [
        ("stages", |plan| plan.stages.clear()),
        ("stages", |plan| plan.stages.push("few".to_owned())),
        ("held_for_s", |plan| plan.held_for_s = 0.0),
        ("soak_s", |plan| plan.soak_s = f64::NAN),
        ("soak_s", |plan| plan.soak_s = 0.0),
        ("confidence", |plan| plan.basics.confidence = 1.0),
        ("fewest_clips", |plan| plan.basics.fewest_clips = 1),
        ("fewest_applied", |plan| plan.fewest_applied = 0.0),
    ];
    for (field, change) in changes {
        let mut wrong = plan();
        change(&mut wrong);
        assert!(wrong.check().unwrap_err().starts_with(field), "{field}");
    }
    RolloutPlan::default().check().unwrap();
    let nobody = Kind::Rollout {
        to: new(),
        plan: plan(),
    };
    let error = Run::begin(nobody, vec![], 1, "ops", 0).unwrap_err();
    assert!(error.starts_with("select: no selected node"), "{error}");
}

#[test]
fn stages_that_shrink_are_rejected_and_whether_they_do_depends_on_no_fleet() {
    let begin = |nodes: usize, stages: &[&str]| {
        let plan = RolloutPlan {
            stages: stages.iter().map(|size| (*size).to_owned()).collect(),
            ..plan()
        };
        let kind = Kind::Rollout { to: new(), plan };
        Run::begin(kind, World::new(nodes).candidates(), 7, "ops", 0)
    };
    for nodes in [1, 3, 40] {
        for stages in [
            ["1", "50%", "10%"],
            ["1", "all", "50%"],
            ["1", "all", "40"],
            ["20", "10%", "5"],
        ] {
            let error = begin(nodes, &stages).unwrap_err();
            assert!(error.starts_with("stages: `"), "{error}");
            assert!(error.contains("sizes must grow"), "{error}");
        }
        for stages in [
            ["1", "10%", "100%"],
            ["2", "10%", "all"],
            ["10%", "2", "all"],
        ] {
            assert!(begin(nodes, &stages).is_ok(), "{nodes}: {stages:?}");
        }
    }
}
