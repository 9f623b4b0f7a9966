//! What of a drive can speak against it: the kinds of evidence that the envelope weighs, and by which the supervisor
//! chooses what it does.

/// A kind of evidence. The envelope looks at some of them over several times; they count as one here.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Channel {
    /// The quality of tracking, q = 1/(1 + √(Ē_y² + 10 Ē_θ²)) over 1 s, the paper's Q.
    Quality,
    /// The mean lateral tracking error over 3 s.
    LateralError,
    /// How far the vehicle came along its heading, against dead reckoning from its speed and the commanded steering.
    Along,
    /// How far it came to the side, against the same.
    Lateral,
    /// How far it turned, against the same.
    Yaw,
    /// How much the measured pose jumps from tick to tick.
    Noise,
}

impl Channel {
    /// All kinds, in the order of their numbers.
    pub const ALL: [Self; 6] =
        [Self::Quality, Self::LateralError, Self::Along, Self::Lateral, Self::Yaw, Self::Noise];

    /// The name in files and results.
    pub fn name(self) -> &'static str {
        match self {
            Self::Quality => "quality",
            Self::LateralError => "lateral_error",
            Self::Along => "along",
            Self::Lateral => "lateral",
            Self::Yaw => "yaw",
            Self::Noise => "noise",
        }
    }

    /// The number on the wire: 1 for the first kind. 0 says that none has spoken.
    pub fn number(self) -> u32 {
        self as u32 + 1
    }

    /// The kind of this number on the wire.
    pub fn of_number(number: u32) -> Option<Self> {
        Self::ALL.get(usize::try_from(number).ok()?.checked_sub(1)?).copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_number_names_one_kind() {
        for channel in Channel::ALL {
            assert_eq!(Channel::of_number(channel.number()), Some(channel));
        }
        assert_eq!((Channel::of_number(0), Channel::of_number(7)), (None, None));
    }
}
