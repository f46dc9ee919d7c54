//! When a service that has ended is started again. Pure: time is an argument.

use shell::{Restart, ServiceTable};
use std::collections::VecDeque;
use std::fmt;

/// The first pause before a restart, after a run that was too short [ns]. It doubles with every further one.
const PAUSE_FIRST_NS: u64 = 100_000_000;
/// The longest pause [ns].
const PAUSE_MAX_NS: u64 = 5_000_000_000;
const MS_NS: u64 = 1_000_000;
/// How long a service that keeps dying is left alone [ns].
const HOLD_NS: u64 = 30_000_000_000;
/// What ends a process without its doing: an operator, a test, the kernel for want of memory.
const SIGKILL: Ending = Ending::Signal(9);
/// The first pause after such ends of young processes [ns], after how many, and how often it doubles.
const PAUSE_KILLED_NS: u64 = 5_000_000;
const KILLED_FREELY: u32 = 4;
const PAUSE_KILLED_DOUBLINGS: u32 = 5;
/// The exit code of a configuration error: starting again cannot mend it.
const EXIT_CONFIG: i32 = 78;

/// The restart rules of one service, and what they need to remember.
#[derive(Clone, Debug)]
pub struct Policy {
    restart: Restart,
    intensity: usize,
    period_ns: u64,
    minimum_run_ns: u64,
    /// Instants of the restarts within the last period.
    restarts: VecDeque<u64>,
    short_runs: u32,
}

/// How a service ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ending {
    /// With this exit code.
    Code(i32),
    /// By this signal.
    Signal(i32),
    /// By the launcher: it was silent for too long.
    Hung,
}

impl fmt::Display for Ending {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Code(code) => write!(formatter, "ended with code {code}"),
            Self::Signal(signal) => write!(formatter, "ended by signal {signal}"),
            Self::Hung => formatter.write_str("ended because it hung"),
        }
    }
}

/// What to do with a service that has ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Decision {
    /// Start it at this instant.
    RestartAt(u64),
    /// Leave it until this instant, and say why; the others go on. What was wrong may have passed by then.
    HoldUntil(u64, String),
    /// Leave it, and say why; the others go on.
    GiveUp(String),
    /// It has ended as it should.
    Rest,
}

impl Policy {
    /// The rules that a system file gives.
    #[must_use]
    pub fn new(table: &ServiceTable) -> Self {
        Self {
            restart: table.restart,
            intensity: *table.intensity.get_ref() as usize,
            period_ns: table.intensity_period_ms.get_ref() * MS_NS,
            minimum_run_ns: table.minimum_run_ms.get_ref() * MS_NS,
            restarts: VecDeque::with_capacity(*table.intensity.get_ref() as usize + 1),
            short_runs: 0,
        }
    }

    /// Decides about a service that started at `started_ns` and ended now.
    pub fn on_end(&mut self, ending: Ending, started_ns: u64, now_ns: u64) -> Decision {
        let wanted = match self.restart {
            Restart::Always => true,
            Restart::OnFailure => ending != Ending::Code(0),
            Restart::Never => false,
        };
        if ending == Ending::Code(EXIT_CONFIG) {
            return Decision::GiveUp("its configuration is wrong, which a restart cannot mend".into());
        }
        if !wanted {
            return if ending == Ending::Code(0) {
                Decision::Rest
            } else {
                Decision::GiveUp("it is not to be restarted".into())
            };
        }
        let is_young = now_ns.saturating_sub(started_ns) < self.minimum_run_ns;
        if ending == SIGKILL {
            // It says nothing against the service: however often, it comes back.
            self.short_runs = if is_young { self.short_runs.saturating_add(1) } else { 0 };
            let pause_ns = match self.short_runs.checked_sub(KILLED_FREELY) {
                Some(further) => PAUSE_KILLED_NS << further.min(PAUSE_KILLED_DOUBLINGS),
                None => 0,
            };
            return Decision::RestartAt(now_ns + pause_ns);
        }
        while self
            .restarts
            .front()
            .is_some_and(|at| now_ns.saturating_sub(*at) > self.period_ns)
        {
            self.restarts.pop_front();
        }
        if self.restarts.len() >= self.intensity {
            let period_s = self.period_ns / (1000 * MS_NS);
            self.restarts.clear();
            self.short_runs = 0;
            let why = format!("{} restarts within {period_s} s are too many", self.intensity);
            return Decision::HoldUntil(now_ns + HOLD_NS, why);
        }
        self.restarts.push_back(now_ns);
        // The first crash after a long run is bad luck, and every millisecond counts; a crash loop is slowed.
        if !is_young {
            self.short_runs = 0;
            return Decision::RestartAt(now_ns);
        }
        let pause_ns = PAUSE_FIRST_NS
            .saturating_mul(1 << self.short_runs.min(16))
            .min(PAUSE_MAX_NS);
        self.short_runs += 1;
        Decision::RestartAt(now_ns + pause_ns)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: u64 = 1_000_000_000;
    const CRASHED: Ending = Ending::Signal(11);

    fn policy(keys: &str) -> Policy {
        Policy::new(&toml::from_str::<ServiceTable>(&format!("exec = ['a']\n{keys}")).unwrap())
    }

    #[test]
    fn a_service_that_ran_long_enough_is_back_at_once() {
        assert_eq!(
            policy("").on_end(CRASHED, 0, 2 * SECOND),
            Decision::RestartAt(2 * SECOND)
        );
    }

    #[test]
    fn a_crash_loop_is_slowed() {
        let mut policy = policy("");
        let mut now = 0;
        let mut pauses_ms = Vec::new();
        for _ in 0..5 {
            let Decision::RestartAt(at) = policy.on_end(CRASHED, now, now + 1) else {
                panic!()
            };
            pauses_ms.push((at - now) / MS_NS);
            now = at;
        }
        assert_eq!(pauses_ms, [100, 200, 400, 800, 1600]);
    }

    #[test]
    fn too_many_restarts_within_the_period_are_the_last() {
        let mut policy = policy("intensity = 2\nintensity_period_ms = 10000\nminimum_run_ms = 0");
        assert_eq!(policy.on_end(CRASHED, 0, SECOND), Decision::RestartAt(SECOND));
        assert_eq!(policy.on_end(CRASHED, 0, 2 * SECOND), Decision::RestartAt(2 * SECOND));
        assert!(matches!(
            policy.on_end(CRASHED, 0, 3 * SECOND),
            Decision::HoldUntil(until, _) if until == 3 * SECOND + HOLD_NS
        ));
        assert!(matches!(policy.on_end(CRASHED, 0, 40 * SECOND), Decision::RestartAt(_)));
    }

    #[test]
    fn restarts_longer_ago_than_the_period_do_not_count() {
        let mut policy = policy("intensity = 1\nintensity_period_ms = 10000\nminimum_run_ms = 0");
        assert_eq!(policy.on_end(CRASHED, 0, SECOND), Decision::RestartAt(SECOND));
        assert_eq!(policy.on_end(CRASHED, 0, 12 * SECOND), Decision::RestartAt(12 * SECOND));
    }

    #[test]
    fn a_service_that_others_kill_always_comes_back_and_soon() {
        let mut policy = policy("intensity = 2");
        let mut now = 0;
        for _ in 0..1000 {
            let Decision::RestartAt(at) = policy.on_end(SIGKILL, now, now + 1) else {
                panic!()
            };
            assert!(at - now <= 200 * MS_NS);
            now = at;
        }
        assert_eq!(
            policy.on_end(SIGKILL, now, now + 2 * SECOND),
            Decision::RestartAt(now + 2 * SECOND)
        );
    }

    #[test]
    fn a_configuration_error_is_not_tried_again() {
        assert!(matches!(
            policy("").on_end(Ending::Code(78), 0, 9 * SECOND),
            Decision::GiveUp(_)
        ));
    }

    #[test]
    fn the_restart_rule_decides_about_a_clean_end() {
        let clean = Ending::Code(0);
        assert_eq!(
            policy("restart = 'on_failure'").on_end(clean, 0, 9 * SECOND),
            Decision::Rest
        );
        assert_eq!(policy("restart = 'never'").on_end(clean, 0, 9 * SECOND), Decision::Rest);
        assert_eq!(policy("").on_end(clean, 0, 9 * SECOND), Decision::RestartAt(9 * SECOND));
        assert!(matches!(
            policy("restart = 'never'").on_end(CRASHED, 0, 9 * SECOND),
            Decision::GiveUp(_)
        ));
    }
}
