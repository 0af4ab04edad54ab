//! The hidden states that sampling generates.

/// For every timestep, whether it is hidden and to be generated when sampling.
///
/// `is_shown` tells which timesteps the mask observes, `is_recorded` at which the recording has a state. A shown
/// timestep is never generated: if it has no state, the agent is known not to have been tracked. Hidden timesteps form
/// stretches between shown ones. A whole stretch is generated if the agent is tracked at the shown timestep before or
/// after it, since the time at which it came or went in between must stay hidden. Without a state at either end (before
/// the agent came, after it left, or because it is never observed) nothing is generated.
pub(super) fn generated_timesteps(
    n_timesteps: usize,
    is_shown: impl Fn(usize) -> bool,
    is_recorded: impl Fn(usize) -> bool,
) -> Vec<bool> {
    let mut generated = vec![false; n_timesteps];
    let mut timestep = 0;
    let mut is_tracked_before = false;
    while timestep < n_timesteps {
        if is_shown(timestep) {
            is_tracked_before = is_recorded(timestep);
            timestep += 1;
            continue;
        }
        let end = (timestep..n_timesteps).find(|t| is_shown(*t)).unwrap_or(n_timesteps);
        let is_tracked_after = end < n_timesteps && is_recorded(end);
        generated[timestep..end].fill(is_tracked_before || is_tracked_after);
        timestep = end;
    }
    generated
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `shown`: `o` observed, `.` hidden; `recorded`: `x` a state, `.` none; the result: `g` generated.
    fn generated(shown: &str, recorded: &str) -> String {
        let holds = |text: &str, t: usize, c: u8| text.as_bytes()[t] == c;
        let generated = generated_timesteps(shown.len(), |t| holds(shown, t, b'o'), |t| holds(recorded, t, b'x'));
        generated.into_iter().map(|is_generated| if is_generated { 'g' } else { '.' }).collect()
    }

    #[test]
    fn prediction_generates_the_whole_future_of_who_is_present() {
        assert_eq!(generated("oooo....", "xxxxxx.."), "....gggg");
        // It appears within the history: nothing is generated before.
        assert_eq!(generated("oooo....", "..xxxx.."), "....gggg");
        // It has left before the present.
        assert_eq!(generated("oooo....", "xx......"), "........");
        assert_eq!(generated("oooo....", "....xxxx"), "........");
    }

    #[test]
    fn windows_are_filled_for_who_is_tracked_on_either_side() {
        assert_eq!(generated("ooo..ooo", "xxxxxxxx"), "...gg...");
        assert_eq!(generated("ooo..ooo", "xxxx...."), "...gg...");
        assert_eq!(generated("ooo..ooo", "....xxxx"), "...gg...");
        assert_eq!(generated("ooo..ooo", "xx....xx"), "........");
        assert_eq!(generated("..oooooo", "xxxxxxxx"), "gg......");
    }

    #[test]
    fn upsampling_and_imputation_stay_within_the_time_an_agent_is_there() {
        assert_eq!(generated("o..o..o..", "xxxxxxxxx"), ".gg.gg.gg");
        // Gone after timestep 4: between 6 and the end nothing is known of it, and nothing is generated.
        assert_eq!(generated("o..o..o..", "xxxxx...."), ".gg.gg...");
        // A shown gap stays a gap; the stretches beside it touch a tracked state on one side.
        assert_eq!(generated("o.o.o.o.o", "xx...xxxx"), ".g...g.g.");
    }

    #[test]
    fn nothing_is_generated_of_who_is_never_observed() {
        assert_eq!(generated("....", "xxxx"), "....");
    }
}
