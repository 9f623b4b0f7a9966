//! Whether the commands arrive: whoever receives them reliably acknowledges them.
//!
//! Pure: the time is an argument.

/// What is known of the commands that were sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Answer {
    /// Nothing was sent.
    NotAsked,
    /// One that was sent is not acknowledged yet.
    Awaited,
    /// The one that was awaited has been acknowledged.
    Given,
}

/// Commands that nobody has acknowledged for so long are not heard.
const SILENT_NS: u64 = 300_000_000;
/// If they are still not heard after so long, the drive does not go on.
const LOST_NS: u64 = 1_000_000_000;
/// What a single look adds at most: a process that was not served does not take that for silence.
const LONGEST_LOOK_NS: u64 = 20_000_000;
/// Silence is forgotten once nothing has been sent for so long: then nobody could answer. A process that is held up, as by
/// joining the network anew, sends nothing for a moment, and goes on waiting for its answer.
const FORGOTTEN_NS: u64 = 500_000_000;
/// Time until the network is joined anew once more; it doubles each time.
const REJOIN_NS: u64 = 1_000_000_000;
const REJOIN_AT_MOST_NS: u64 = 16_000_000_000;

/// How long nobody has acknowledged a command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Hearing {
    silent_ns: u64,
    /// How long nothing has been sent.
    idle_ns: u64,
    looked_ns: u64,
    is_answered: bool,
    rejoin_ns: u64,
    between_ns: u64,
    longest_ns: u64,
}

impl Default for Hearing {
    fn default() -> Self {
        Self {
            silent_ns: 0,
            idle_ns: 0,
            looked_ns: 0,
            is_answered: false,
            rejoin_ns: 0,
            between_ns: REJOIN_NS,
            longest_ns: 0,
        }
    }
}

impl Hearing {
    /// Takes a look. `commands`: commands are being sent.
    pub fn look(&mut self, answer: Answer, commands: bool, now_ns: u64) {
        let since_ns = now_ns.saturating_sub(self.looked_ns).min(LONGEST_LOOK_NS);
        self.looked_ns = now_ns;
        self.idle_ns = if commands { 0 } else { self.idle_ns + since_ns };
        match answer {
            Answer::Given => {
                self.is_answered = true;
                (self.silent_ns, self.between_ns) = (0, REJOIN_NS);
            }
            _ if self.idle_ns >= FORGOTTEN_NS => self.silent_ns = 0,
            _ if !commands => {}
            // Joined anew, and nobody is there yet.
            Answer::NotAsked if self.silent_ns == 0 => {}
            Answer::NotAsked | Answer::Awaited => self.silent_ns += since_ns,
        }
        self.longest_ns = self.longest_ns.max(self.silent_ns);
    }

    /// A drive is to begin: what was not heard before does not count.
    pub fn begin(&mut self) {
        self.ask_again();
        self.silent_ns = 0;
    }

    /// What was heard before does not tell whether the next command is.
    pub fn ask_again(&mut self) {
        self.is_answered = false;
    }

    /// Whether a command has been acknowledged.
    pub fn is_answered(&self) -> bool {
        self.is_answered
    }

    /// Whether commands are not heard.
    pub fn is_silent(&self) -> bool {
        self.silent_ns >= SILENT_NS
    }

    /// Whether they have not been heard for so long that the drive does not go on.
    pub fn is_lost(&self) -> bool {
        self.silent_ns >= LOST_NS
    }

    /// Whether to join the network anew now, because commands are not heard.
    pub fn rejoins(&mut self, now_ns: u64) -> bool {
        let is_due = self.is_silent() && now_ns >= self.rejoin_ns;
        if is_due {
            self.is_answered = false;
            self.rejoin_ns = now_ns + self.between_ns;
            self.between_ns = (2 * self.between_ns).min(REJOIN_AT_MOST_NS);
        }
        is_due
    }

    /// The longest time for which no command was acknowledged.
    pub fn longest_ns(&self) -> u64 {
        self.longest_ns
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;
    const T0: u64 = 1_000_000 * MS;

    /// Looks every 5 ms from one time to before another, in milliseconds.
    fn look(hearing: &mut Hearing, answer: Answer, from_ms: u64, to_ms: u64) {
        (from_ms..to_ms).step_by(5).for_each(|ms| hearing.look(answer, true, T0 + ms * MS));
    }

    #[test]
    fn silence_is_noticed_and_the_network_joined_anew_ever_less_often() {
        let mut hearing = Hearing::default();
        look(&mut hearing, Answer::NotAsked, 0, 1000);
        assert!(!hearing.is_silent() && !hearing.is_answered());
        look(&mut hearing, Answer::Given, 1000, 1005);
        assert!(hearing.is_answered());
        look(&mut hearing, Answer::Awaited, 1005, 1300);
        assert!(!hearing.is_silent() && !hearing.rejoins(T0 + 1300 * MS));
        look(&mut hearing, Answer::Awaited, 1300, 1310);
        assert!(hearing.is_silent() && !hearing.is_lost() && hearing.is_answered());
        assert!(hearing.rejoins(T0 + 1310 * MS) && !hearing.rejoins(T0 + 1315 * MS));
        assert!(!hearing.is_answered());
        // Nobody is found.
        look(&mut hearing, Answer::NotAsked, 1310, 2005);
        assert!(hearing.is_lost() && !hearing.rejoins(T0 + 2300 * MS));
        assert!(hearing.rejoins(T0 + 2310 * MS) && !hearing.rejoins(T0 + 4300 * MS));
        look(&mut hearing, Answer::Given, 4300, 4305);
        assert!(!hearing.is_silent() && !hearing.is_lost() && hearing.is_answered());
        assert_eq!(hearing.longest_ns(), 1000 * MS);
        hearing.ask_again();
        assert!(!hearing.is_answered());
    }

    #[test]
    fn a_process_that_is_held_up_while_it_joins_anew_still_gives_up() {
        let mut hearing = Hearing::default();
        look(&mut hearing, Answer::Given, 0, 5);
        look(&mut hearing, Answer::Awaited, 5, 400);
        assert!(hearing.rejoins(T0 + 400 * MS));
        // That took so long that nothing was sent meanwhile.
        hearing.look(Answer::NotAsked, false, T0 + 700 * MS);
        assert!(hearing.is_silent());
        look(&mut hearing, Answer::NotAsked, 705, 1400);
        assert!(hearing.is_lost());
        hearing.begin();
        assert!(!hearing.is_silent() && !hearing.is_answered());
    }

    #[test]
    fn neither_a_process_that_was_not_served_nor_one_that_sends_nothing_is_silent() {
        let mut hearing = Hearing::default();
        look(&mut hearing, Answer::Given, 0, 5);
        look(&mut hearing, Answer::Awaited, 5000, 5250);
        assert!(!hearing.is_silent());
        look(&mut hearing, Answer::Awaited, 5250, 5300);
        assert!(hearing.is_silent());
        for ms in (5300..5780).step_by(20) {
            hearing.look(Answer::Awaited, false, T0 + ms * MS);
            assert!(hearing.is_silent());
        }
        for ms in [5800, 5820] {
            hearing.look(Answer::Awaited, false, T0 + ms * MS);
        }
        assert!(!hearing.is_silent());
    }
}
