//! Kills, hangs, terminations and swaps at random instants: no estimation cycle is lost, none comes twice, no estimate starts
//! over. The table of many more is `cargo bench -p bench --bench chaos`.

use crate::rover::alone;
use bench::chaos::{Fault, Plan, run};
use shell::Termination;

#[test]
fn no_fault_of_a_stage_costs_a_cycle() {
    let _alone = alone();
    let plan = Plan {
        programs: bench::programs().unwrap(),
        seed: 20_041,
        faults: 30,
        rate_hz: 30,
        kinds: Fault::ALL.to_vec(),
    };
    let verdict = run(&plan, &Termination::listen().unwrap(), |_| ()).unwrap();
    let (table, total) = (verdict.table(), verdict.total());
    println!("{table}");
    assert!(total.expected > 200, "{table}");
    assert_eq!((total.lost(), total.doubled, total.started_over), (0, 0, 0), "{table}");
    assert_eq!((verdict.left, verdict.code), ([0, 0], Some(0)), "{table}");
    let [[descriptors_before, files_before, _], [descriptors, files, _]] = verdict.held;
    assert!(
        descriptors <= descriptors_before + 4 && files <= files_before + 4,
        "{table}"
    );
}
