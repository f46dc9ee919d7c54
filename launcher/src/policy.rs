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
/// How a process ends that was told to; a stage never ends so by itself.
const TOLD: Ending = Ending::Code(0);
/// The first pause after such ends of young processes [ns], after how many, and how often it doubles.
const PAUSE_ENDED_NS: u64 = 5_000_000;
const ENDED_FREELY: u32 = 4;
const PAUSE_ENDED_DOUBLINGS: u32 = 5;
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
    /// Young processes one after the other that failed, and that others ended.
    failed_young: u32,
    ended_young: u32,
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
            failed_young: 0,
            ended_young: 0,
        }
    }

    /// Decides about a service that started at `started_ns` and ended now.
    pub fn on_end(&mut self, ending: Ending, started_ns: u64, now_ns: u64) -> Decision {
        let wanted = match self.restart {
            Restart::Always => true,
            Restart::OnFailure => ending != TOLD,
            Restart::Never => false,
        };
        if ending == Ending::Code(EXIT_CONFIG) {
            return Decision::GiveUp("its configuration is wrong, which a restart cannot mend".into());
        }
        if !wanted {
            return if ending == TOLD {
                Decision::Rest
            } else {
                Decision::GiveUp("it is not to be restarted".into())
            };
        }
        let is_young = now_ns.saturating_sub(started_ns) < self.minimum_run_ns;
        if !is_young {
            self.failed_young = 0;
            self.ended_young = 0;
        }
        if ending == SIGKILL {
            // However often: it says nothing against the service.
            return Decision::RestartAt(now_ns + self.pause_ended_ns(is_young));
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
            self.failed_young = 0;
            self.ended_young = 0;
            let why = format!("{} restarts within {period_s} s are too many", self.intensity);
            return Decision::HoldUntil(now_ns + HOLD_NS, why);
        }
        self.restarts.push_back(now_ns);
        let pause_ns = if ending == TOLD {
            self.pause_ended_ns(is_young)
        } else {
            self.pause_failed_ns(is_young)
        };
        Decision::RestartAt(now_ns + pause_ns)
    }

    /// Others have ended it, and every millisecond counts.
    fn pause_ended_ns(&mut self, is_young: bool) -> u64 {
        self.ended_young = self.ended_young.saturating_add(u32::from(is_young));
        match self.ended_young.checked_sub(ENDED_FREELY) {
            Some(further) => PAUSE_ENDED_NS << further.min(PAUSE_ENDED_DOUBLINGS),
            None => 0,
        }
    }

    /// The first crash after a long run is bad luck; a crash loop is slowed.
    fn pause_failed_ns(&mut self, is_young: bool) -> u64 {
        if !is_young {
            return 0;
        }
        let pause_ns = PAUSE_FIRST_NS << self.failed_young.min(16);
        self.failed_young += 1;
        pause_ns.min(PAUSE_MAX_NS)
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
    fn a_service_that_is_told_to_end_comes_back_as_soon_unless_it_ends_all_the_time() {
        let mut policy = policy("intensity = 10\nintensity_period_ms = 10000");
        let mut now = 0;
        for _ in 0..100 {
            let Decision::RestartAt(at) = policy.on_end(TOLD, now, now + SECOND / 2) else {
                // Ten of them took more than 5 s, and the pauses between them at most 10 times 160 ms.
                assert!(now > 5 * SECOND);
                return;
            };
            assert!(at - (now + SECOND / 2) <= 200 * MS_NS);
            now = at;
        }
        panic!("a program that ends by itself is never given up");
    }

    #[test]
    fn what_others_did_does_not_slow_the_restart_after_a_crash() {
        let mut policy = policy("");
        for _ in 0..20 {
            policy.on_end(SIGKILL, 0, 1);
        }
        assert_eq!(policy.on_end(CRASHED, 0, 1), Decision::RestartAt(1 + PAUSE_FIRST_NS));
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
        assert_eq!(
            policy("restart = 'on_failure'").on_end(TOLD, 0, 9 * SECOND),
            Decision::Rest
        );
        assert_eq!(policy("restart = 'never'").on_end(TOLD, 0, 9 * SECOND), Decision::Rest);
        assert_eq!(policy("").on_end(TOLD, 0, 9 * SECOND), Decision::RestartAt(9 * SECOND));
        assert!(matches!(
            policy("restart = 'never'").on_end(CRASHED, 0, 9 * SECOND),
            Decision::GiveUp(_)
        ));
    }
}
