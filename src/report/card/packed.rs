//! Packs thousands of scenes into one page: as whole numbers, differenced, in as few letters as possible.
//!
//! Positions are centimeters and headings hundredths of a radian. A number is written in base 64 with five bits a
//! letter, the lowest bit of all being the sign (the variable-length quantities of source maps). Consecutive states are
//! written as the error of linear extrapolation, which is one letter for most traffic. `player.js` reads what this file
//! writes.

use super::{DrawnLane, DrawnSample};

const LETTERS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";

/// Numbers written as letters.
#[derive(Default)]
struct Packed(String);

impl Packed {
    fn push(&mut self, number: i64) {
        let mut rest = number.unsigned_abs() << 1 | u64::from(number < 0);
        loop {
            let (digit, more) = (rest & 31, rest >> 5);
            let letter = LETTERS[(digit | u64::from(more > 0) << 5) as usize];
            self.0.push(char::from(letter));
            if more == 0 {
                return;
            }
            rest = more;
        }
    }

    fn push_len(&mut self, n: usize) {
        self.push(i64::try_from(n).unwrap_or(i64::MAX / 4));
    }
}

/// The lanes: their number; for each, three lines: the number of points and their steps in x and y; then what its light
/// shows: the number of changes, and the state, first and last timestep of each.
pub(in crate::report) fn pack_lanes(lanes: &[DrawnLane]) -> String {
    let mut packed = Packed::default();
    packed.push_len(lanes.len());
    for lane in lanes {
        for line in [&lane.centerline, &lane.left, &lane.right] {
            packed.push_len(line.len());
            let mut before = [0, 0];
            for point in line {
                let now = point.map(hundredths);
                packed.push(now[0] - before[0]);
                packed.push(now[1] - before[1]);
                before = now;
            }
        }
        packed.push_len(lane.lights.len());
        for (light, timesteps) in &lane.lights {
            packed.push(*light as i64);
            packed.push_len(*timesteps.start());
            packed.push_len(*timesteps.end());
        }
    }
    packed.0
}

/// The states of the agents in `ids`, in that order; none for agents that are not in the sample. For each agent: the
/// number of stretches of states; for each stretch: whether it was observed, the timesteps since the last one, its
/// length, and its states.
pub(in crate::report) fn pack_sample(sample: &DrawnSample, ids: &[&str]) -> String {
    let mut packed = Packed::default();
    for id in ids {
        let Some(agent) = sample.agents.iter().find(|agent| agent.id == *id) else {
            packed.push(0);
            continue;
        };
        let stretches = agent.stretches();
        packed.push_len(stretches.len());
        let mut end_before = 0;
        // The last two states, for extrapolation; the first state is written as it is, the second as a step from it.
        let mut last: Option<[[i64; 3]; 2]> = None;
        for (observed, start, end) in stretches {
            packed.push(i64::from(observed));
            packed.push_len(start - end_before);
            packed.push_len(end - start);
            for state in agent.states[start..end].iter().flatten() {
                let now = state.map(hundredths);
                for axis in 0..3 {
                    packed.push(now[axis] - last.map_or(0, |[before, last]| 2 * last[axis] - before[axis]));
                }
                last = Some(last.map_or([now, now], |[_, last]| [last, now]));
            }
            end_before = end;
        }
    }
    packed.0
}

fn hundredths(value: f64) -> i64 {
    (value * 100.0).round() as i64
}

#[cfg(test)]
mod tests {
    use super::super::{DrawnAgent, Light};
    use super::*;

    fn letters(numbers: &[i64]) -> String {
        let mut packed = Packed::default();
        numbers.iter().for_each(|number| packed.push(*number));
        packed.0
    }

    /// Reads numbers by the definition of the format, independently of the writer.
    fn numbers(letters: &str) -> Vec<i64> {
        let mut found = Vec::new();
        let (mut value, mut shift) = (0i64, 0);
        for letter in letters.bytes() {
            let digit = LETTERS.iter().position(|known| *known == letter).unwrap() as i64;
            value |= (digit & 31) << shift;
            shift += 5;
            if digit < 32 {
                found.push(if value & 1 == 1 { -(value >> 1) } else { value >> 1 });
                (value, shift) = (0, 0);
            }
        }
        found
    }

    #[test]
    fn letters_are_those_of_source_maps() {
        // 0 to A, 1 to C, -1 to D, 15 to e; 16 is the first that needs two. By hand, and by a program in another
        // language.
        assert_eq!(letters(&[0, 1, -1, 15, 16, 123, 123_456_789]), "ACDegB2HqxmvrH");
        let all: Vec<i64> = (-5000..5000).chain([1 << 40, -(1 << 40)]).collect();
        assert_eq!(numbers(&letters(&all)), all);
    }

    #[test]
    fn states_come_back_to_the_centimeter() {
        let states: Vec<Option<[f64; 3]>> = (0..30)
            .map(|t| f64::from(t) * 0.1)
            .map(|t| ((t - 1.0).abs() > 0.25).then_some([12.5 * t, -3.5 + 0.4 * t * t, 0.05 * t]))
            .collect();
        let observed: Vec<bool> = (0..30).map(|t| t < 5 || t == 29).collect();
        let agent =
            DrawnAgent { id: "7".into(), role: None, length_m: 4.5, width_m: 1.9, states: states.clone(), observed };
        let sample = DrawnSample { name: "sample 0".into(), agents: vec![agent.clone()] };
        let text = pack_sample(&sample, &["absent", "7"]);
        let found = numbers(&text);
        let mut read = found.into_iter();
        let mut next = || read.next().unwrap();
        assert_eq!(next(), 0, "the absent agent has no stretches");
        let (n_stretches, mut timestep, mut last) = (next(), 0, [[0; 3]; 2]);
        let mut is_first = true;
        for _ in 0..n_stretches {
            let is_observed = next() == 1;
            timestep += next() as usize;
            for _ in 0..next() {
                let now = [0, 1, 2].map(|axis| 2 * last[1][axis] - last[0][axis] + next());
                last = if is_first { [now, now] } else { [last[1], now] };
                is_first = false;
                let expected = states[timestep].unwrap();
                for axis in 0..3 {
                    assert!((now[axis] as f64 / 100.0 - expected[axis]).abs() <= 0.005 + 1e-9);
                }
                assert_eq!(is_observed, agent.observed[timestep]);
                timestep += 1;
            }
        }
        assert_eq!((timestep, read.next()), (30, None));
        // Three numbers a state; 25 states, with four letters each at the beginning.
        assert!(text.len() < 25 * 4 + 40, "{} letters", text.len());
    }

    #[test]
    fn lanes_are_steps_between_points() {
        let mut lane = DrawnLane {
            centerline: vec![[1.0, 2.0], [1.5, 2.0]],
            left: vec![],
            right: vec![[0.0, -1.0]],
            lights: Vec::new(),
        };
        assert_eq!(numbers(&pack_lanes(&[lane.clone()])), [1, 2, 100, 200, 50, 0, 0, 1, 0, -100, 0]);
        lane.lights = vec![(Light::Stop, 0..=4), (Light::Go, 7..=90)];
        assert_eq!(numbers(&pack_lanes(&[lane]))[10..], [2, 1, 0, 4, 3, 7, 90]);
    }
}
