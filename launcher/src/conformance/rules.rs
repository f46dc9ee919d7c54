//! The rules of the replacement contract, a row each: what is promised, and how it shows in what was seen.
//!
//! A new rule is a row here, a function that judges, and, in `trial.rs`, what has to be done and seen for it.

use super::stand::{Refusal, ending};
use super::trial::{Answer, Evidence, Exchange, TERM_MAX_NS};
use std::collections::BTreeMap;

/// Growth of a process's own memory that is none [bytes]: allocators round up.
const GROWTH_MAX: u64 = 1 << 20;
/// Exit code for a wrong configuration.
const EXIT_CONFIG: i32 = 78;

/// A rule.
pub struct Rule {
    name: &'static str,
    promise: &'static str,
    judge: fn(&Evidence) -> Verdict,
}

/// What was seen: as it should be, or not.
type Verdict = Result<String, String>;

/// What became of a rule.
pub struct Finding {
    /// The rule's name.
    pub rule: &'static str,
    /// What is promised.
    pub promise: &'static str,
    /// Whether it holds.
    pub holds: bool,
    /// What was seen.
    pub seen: String,
}

impl Rule {
    /// Whether the rule holds.
    pub fn judge(&self, evidence: &Evidence) -> Finding {
        let verdict = (self.judge)(evidence);
        Finding {
            rule: self.name,
            promise: self.promise,
            holds: verdict.is_ok(),
            seen: verdict.unwrap_or_else(|seen| seen),
        }
    }
}

const fn rule(name: &'static str, promise: &'static str, judge: fn(&Evidence) -> Verdict) -> Rule {
    Rule { name, promise, judge }
}

/// All rules.
pub const RULES: &[Rule] = &[
    rule("start", "opens all its wires within start_timeout_ms", starts),
    rule("one_answer", "sends exactly one answer to each trigger", answers_once),
    rule("order", "answers in the order of the triggers", keeps_order),
    rule(
        "identity",
        "copies sequence and taken_ns from the trigger",
        copies_identity,
    ),
    rule(
        "generation",
        "stamps generation as <root>/<service>.generation says",
        stamps_generation,
    ),
    rule(
        "published",
        "stamps published_ns with CLOCK_MONOTONIC as it sends",
        stamps_published,
    ),
    rule("bell", "rings event 0 after each answer", rings),
    rule(
        "values",
        "sends no value that is infinite, or missing though the status is ok",
        values_hold,
    ),
    rule(
        "bad_input",
        "answers what cannot be believed, and claims to know nothing of it",
        doubts,
    ),
    rule("memory", "needs no more memory the longer it runs", stays_small),
    rule("restart", "goes on after kill -9 and a new start", goes_on),
    rule(
        "end",
        "answers a trigger of status ENDED with ENDED",
        ends_with_the_recording,
    ),
    rule("sigterm", "ends with code 0 within a second of SIGTERM", ends_when_told),
    rule(
        "layout",
        "refuses a wire of another layout, and names the wire",
        refuses_layouts,
    ),
    rule(
        "unknown_name",
        "ends with an error if the system file has no such service",
        refuses_name,
    ),
    rule(
        "unknown_key",
        "refuses a key of its config that it does not know, with code 78",
        refuses_key,
    ),
];

fn starts(evidence: &Evidence) -> Verdict {
    let Some(opened_ns) = evidence.opened_ns[0] else {
        return Err("its wires were never all open".into());
    };
    let seen = format!("open after {} ms", opened_ns / 1_000_000);
    if opened_ns <= evidence.start_timeout_ms * 1_000_000 {
        Ok(seen)
    } else {
        Err(seen)
    }
}

fn answers_once(evidence: &Evidence) -> Verdict {
    let (triggers, answers) = (evidence.good.sent.len(), evidence.good.answers.len());
    let seen = format!("{triggers} triggers, {answers} answers");
    let mut counts: BTreeMap<u64, usize> = BTreeMap::new();
    for answer in &evidence.good.answers {
        *counts.entry(answer.header.sequence).or_default() += 1;
    }
    if let Some((sequence, count)) = counts.iter().find(|(_, count)| **count > 1) {
        return Err(format!("{seen}; {count} answers have the sequence {sequence}"));
    }
    some(&evidence.good)?;
    if triggers == answers { Ok(seen) } else { Err(seen) }
}

fn keeps_order(evidence: &Evidence) -> Verdict {
    some(&evidence.good)?;
    let back = evidence
        .good
        .answers
        .windows(2)
        .find(|pair| pair[1].header.sequence < pair[0].header.sequence);
    match back {
        Some(pair) => Err(format!(
            "{} came after {}",
            pair[1].header.sequence, pair[0].header.sequence
        )),
        None => Ok("as sent".into()),
    }
}

fn copies_identity(evidence: &Evidence) -> Verdict {
    some(&evidence.good)?;
    for Answer { header, .. } in &evidence.good.answers {
        match evidence.good.trigger_of(header) {
            None => {
                return Err(format!(
                    "an answer has the sequence {}, which no trigger had",
                    header.sequence
                ));
            }
            Some(sent) if sent.taken_ns != header.taken_ns => {
                return Err(format!(
                    "sequence {} was taken at {} ns, its answer says {} ns",
                    header.sequence, sent.taken_ns, header.taken_ns
                ));
            }
            Some(_) => (),
        }
    }
    Ok("copied".into())
}

fn stamps_generation(evidence: &Evidence) -> Verdict {
    some(&evidence.good)?;
    for (exchange, start) in [(&evidence.good, 1), (&evidence.restarted, 2)] {
        let wrong = exchange.answers.iter().find(|answer| answer.header.generation != start);
        if let Some(answer) = wrong {
            return Err(format!("start {start} was stamped {}", answer.header.generation));
        }
    }
    Ok("1, then 2".into())
}

fn stamps_published(evidence: &Evidence) -> Verdict {
    some(&evidence.good)?;
    let begin_ns = evidence.good.sent.first().map_or(0, |sent| sent.sent_ns);
    for answer in &evidence.good.answers {
        let sent_ns = evidence
            .good
            .trigger_of(&answer.header)
            .map_or(begin_ns, |sent| sent.sent_ns);
        let stamped_ns = answer.header.published_ns;
        if !(sent_ns..=answer.seen_ns).contains(&stamped_ns) {
            return Err(format!(
                "sequence {} was sent at {sent_ns} ns and answered by {} ns, but is stamped {stamped_ns} ns",
                answer.header.sequence, answer.seen_ns
            ));
        }
    }
    Ok("between trigger and arrival".into())
}

fn rings(evidence: &Evidence) -> Verdict {
    some(&evidence.good)?;
    let answers = &evidence.good.answers;
    let rung = answers.iter().filter(|answer| answer.rung).count();
    let seen = format!("{rung} of {} answers came with a ring", answers.len());
    // One ring can be for several, and a busy machine is late.
    if 2 * rung >= answers.len() { Ok(seen) } else { Err(seen) }
}

fn values_hold(evidence: &Evidence) -> Verdict {
    some(&evidence.good)?;
    let bad = evidence.bad.iter().flat_map(|bad| &bad.answers);
    let all = evidence.good.answers.iter().chain(&evidence.long.answers).chain(bad);
    let mut count = 0;
    for answer in all {
        if let Err(what) = answer.check {
            return Err(format!("sequence {}: {what}", answer.header.sequence));
        }
        count += 1;
    }
    Ok(format!("{count} answers"))
}

fn doubts(evidence: &Evidence) -> Verdict {
    some(&evidence.good)?;
    for bad in &evidence.bad {
        let what = bad.what.words();
        if bad.answers.is_empty() {
            return Err(format!("no answer to {what}"));
        }
        if let Some(answer) = bad.answers.iter().find(|answer| answer.header.status.is_answer())
            && bad.hopeless
        {
            let word = answer.header.status.word().unwrap_or_default();
            return Err(format!("{what}: answered with the status {word}"));
        }
    }
    let kinds: Vec<&str> = evidence.bad.iter().map(|bad| bad.what.words()).collect();
    Ok(kinds.join(", "))
}

fn stays_small(evidence: &Evidence) -> Verdict {
    let Some((before, after)) = evidence.memory else {
        return Err("it did not live long enough to tell".into());
    };
    let seen = format!(
        "{} KiB, after {} cycles {} KiB",
        before >> 10,
        evidence.long.sent.len(),
        after >> 10
    );
    if after <= before + GROWTH_MAX {
        Ok(seen)
    } else {
        Err(seen)
    }
}

fn goes_on(evidence: &Evidence) -> Verdict {
    let Some(opened_ns) = evidence.opened_ns[1] else {
        return Err("its wires were not open again".into());
    };
    match evidence.restarted.answers.len() {
        0 => Err("no answer after the new start".into()),
        count => Ok(format!("open after {} ms, {count} answers", opened_ns / 1_000_000)),
    }
}

fn ends_with_the_recording(evidence: &Evidence) -> Verdict {
    let (Some(sent), answers) = &evidence.end else {
        return Err("its wires were not open again".into());
    };
    let Some(answer) = answers.first() else {
        return Err("no answer".into());
    };
    let word = answer.header.status.word().unwrap_or("no known status");
    let same = (answer.header.sequence, answer.header.taken_ns) == (sent.sequence, sent.taken_ns);
    match (answer.header.status == messages::Status::ENDED, same) {
        (true, true) => Ok("answered".into()),
        (true, false) => Err("answered, but with another sequence or taken_ns".into()),
        (false, _) => Err(format!("answered with {word}")),
    }
}

fn ends_when_told(evidence: &Evidence) -> Verdict {
    let (status, took_ns) = evidence.term;
    let seen = format!("{} after {} ms", ending(status), took_ns / 1_000_000);
    let in_time = took_ns <= TERM_MAX_NS;
    if in_time && status.is_some_and(|status| status.success()) {
        Ok(seen)
    } else {
        Err(seen)
    }
}

fn refuses_layouts(evidence: &Evidence) -> Verdict {
    for refusal in &evidence.layouts {
        refused(refusal, |code| code != 0)?;
        if !refusal.said.contains("trial/") {
            return Err(format!(
                "{}: its error does not name the wire: {}",
                refusal.what,
                first_line(&refusal.said)
            ));
        }
    }
    Ok("of an input and of an output".into())
}

fn refuses_name(evidence: &Evidence) -> Verdict {
    evidence
        .unknown_name
        .iter()
        .try_for_each(|refusal| refused(refusal, |code| code != 0))?;
    Ok("refused".into())
}

fn refuses_key(evidence: &Evidence) -> Verdict {
    evidence
        .unknown_key
        .iter()
        .try_for_each(|refusal| refused(refusal, |code| code == EXIT_CONFIG))?;
    Ok("refused".into())
}

/// It ended by itself, with a code that fits, and said why.
fn refused(refusal: &Refusal, fits: impl Fn(i32) -> bool) -> Result<(), String> {
    let ended = format!("{}: {}", refusal.what, ending(refusal.status));
    if !refusal.status.and_then(|status| status.code()).is_some_and(fits) {
        return Err(ended);
    }
    if refusal.said.is_empty() {
        return Err(format!("{ended}, without a word on standard error"));
    }
    Ok(())
}

fn first_line(text: &str) -> &str {
    text.lines().next().unwrap_or_default()
}

/// Without any answer nothing can be said of answers.
fn some(exchange: &Exchange) -> Result<(), String> {
    if exchange.answers.is_empty() {
        return Err("no answer at all".into());
    }
    Ok(())
}
