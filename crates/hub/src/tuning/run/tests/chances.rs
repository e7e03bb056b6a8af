use super::super::*;
use super::{World, new, plan};
use proptest::prelude::*;

#[derive(Clone, Debug)]
enum Chance {
    Returns(usize),
    Leaves(usize),
    Refuses(usize),
    Costs { node: usize, factor: f64 },
    Command(Command),
    Restart,
    Time(usize),
}

fn chance() -> impl Strategy<Value = Chance> {
    let node = 0usize..12;
    let command = prop::sample::select(Command::ALL.to_vec());
    prop_oneof![
        2 => node.clone().prop_map(Chance::Returns),
        2 => node.clone().prop_map(Chance::Leaves),
        1 => node.clone().prop_map(Chance::Refuses),
        1 => (node, 0.5..1.5f64).prop_map(|(node, factor)| Chance::Costs { node, factor }),
        1 => command.prop_map(Chance::Command),
        2 => Just(Chance::Restart),
        6 => (1usize..120).prop_map(Chance::Time),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn no_stage_ever_begins_unjudged_and_a_returned_rollout_leaves_no_node_behind(
        chances in prop::collection::vec(chance(), 0..40), count in 1usize..12,
    ) {
        let mut world = World::new(count);
        let mut rollout = world.begin(plan());
        for chance in chances {
            match chance {
                Chance::Returns(i) => world.node(i).reachable = true,
                Chance::Leaves(i) => world.node(i).reachable = false,
                Chance::Refuses(i) => world.node(i).refuses = true,
                Chance::Costs { node, factor } => world.node(node).factor = factor,
                Chance::Command(command) => {
                    // Many are not possible in the present phase.
                    let _ = rollout.command(command, "ops", world.now);
                }
                Chance::Restart => {
                    // Killed and read from the database, perhaps during a measurement.
                    let text = serde_json::to_string(&rollout).unwrap();
                    rollout = serde_json::from_str(&text).unwrap();
                }
                Chance::Time(seconds) => world.run(&mut rollout, seconds),
            }
            let stage = rollout.stage;
            for member in &rollout.members {
                prop_assert!(member.group < stage || rollout.value_of(member) != Some(new()));
            }
        }
        for (i, entry) in rollout.record.iter().enumerate() {
            if entry.what == What::Stage && entry.stage > 1 {
                let before = &rollout.record[..i];
                let last = before.iter().rfind(|e| matches!(e.what, What::Judged | What::Next)).unwrap();
                prop_assert_eq!(last.stage, entry.stage - 1);
                let passed = matches!(last.verdict, Some(Verdict::Passed | Verdict::NotMeasured));
                prop_assert!(last.what == What::Next || passed);
            }
        }
        // All nodes return; pending work is resolved, and the old value is restored.
        for node in world.nodes.values_mut() {
            node.reachable = true;
            node.refuses = false;
        }
        let _ = rollout.command(Command::Return, "ops", world.now);
        world.run(&mut rollout, 1_000);
        prop_assert_eq!(rollout.phase.name(), "returned");
        prop_assert_eq!(world.have(new()), 0);
    }

    #[test]
    fn an_unattended_rollout_ends_or_is_held(seed in any::<u64>(), count in 1usize..30, away in 0usize..30) {
        let mut world = World::new(count);
        let mut drawn: Vec<usize> = (0..count).collect();
        shuffle(&mut drawn, seed);
        for i in drawn.into_iter().take(away) {
            world.node(i).reachable = false;
        }
        let mut rollout = world.begin(plan());
        world.run(&mut rollout, 3_000);
        let phase = rollout.phase.name();
        prop_assert!(["done", "held", "returned"].contains(&phase), "{} {:?}", phase, rollout.record);
    }
}
