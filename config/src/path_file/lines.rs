//! The lines of a table, and the fields of a line.

/// Signs that begin a comment.
const COMMENTS: [&str; 3] = ["#", "//", "%"];

/// What stands between two fields.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Delimiter {
    Sign(char),
    /// Any number of spaces and tabs.
    Space,
}

/// What stands between the fields of a single tab-separated line.
const TAB: Delimiter = Delimiter::Sign('\t');

impl Delimiter {
    /// What separates the fields of this line.
    pub(super) fn of(line: &str) -> Self {
        let is_decimal = |word: &str| {
            let digits = |it: &str| !it.is_empty() && it.chars().all(|c| c.is_ascii_digit());
            let word = word.trim_start_matches(['-', '+']);
            word.split_once(',').is_some_and(|(whole, part)| digits(whole) && digits(part))
        };
        let words = line.split_whitespace();
        match line {
            _ if line.contains(';') => Self::Sign(';'),
            // Spaces between numbers with a decimal comma.
            _ if words.clone().count() > 1 && words.clone().all(is_decimal) => Self::Space,
            _ if line.contains(',') => Self::Sign(','),
            _ if line.contains('|') => Self::Sign('|'),
            _ => Self::Space,
        }
    }

    /// What separates the names of a header, and the fields of the rows below it. Names and texts may hold spaces between tabs, so
    /// that only both together tell whether single tabs separate them, or white space of any length.
    pub(super) fn of_table(header: Option<&str>, row: &str) -> (Self, Self) {
        let named_by_tabs = header.filter(|header| header.contains('\t'));
        if !holds_tabs(row) {
            return (header.map_or(Self::Space, Self::of), Self::of(row));
        }
        let fits = |by: Self| {
            named_by_tabs.is_none_or(|header| {
                let names = by.fields(header).len();
                by.fields_of(row, names).len() == names
            })
        };
        let aligned = TAB.fields(row).contains(&"");
        let by_tabs =
            if aligned { fits(TAB) && !fits(Self::Space) } else { fits(TAB) || !fits(Self::Space) };
        let of_row = if by_tabs { TAB } else { Self::Space };
        let of_header = match named_by_tabs {
            Some(_) => of_row,
            None => header.map_or(Self::Space, Self::of),
        };
        (of_header, of_row)
    }

    /// The fields of a line, without the quotes and brackets that some programs put around them, and without an empty one
    /// behind a separator at the line's end.
    pub(super) fn fields(self, line: &str) -> Vec<&str> {
        let mut fields = self.all_fields(line);
        if self != Self::Space && fields.len() > 2 && fields.last() == Some(&"") {
            fields.pop();
        }
        fields
    }

    /// The same where a line is to have so many: an empty one at its end may be one of them.
    pub(super) fn fields_of(self, line: &str, count: usize) -> Vec<&str> {
        let all = self.all_fields(line);
        if all.len() == count { all } else { self.fields(line) }
    }

    fn all_fields(self, line: &str) -> Vec<&str> {
        let all: Vec<&str> = match self {
            Self::Sign(sign) => split_outside_quotes(line, sign),
            Self::Space => line.split_whitespace().collect(),
        };
        all.into_iter().map(bare).collect()
    }

    /// It in words.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Sign(';') => "';'",
            Self::Sign('|') => "'|'",
            Self::Sign('\t') => "tabs",
            Self::Sign(_) => "','",
            Self::Space => "spaces",
        }
    }
}

/// Whether tabs may be what separates a row's fields: not beside a sign that does (`1,\t2`), and not beside spaces that do.
fn holds_tabs(row: &str) -> bool {
    const SIGNS: [char; 3] = [',', ';', '|'];
    let is_whole = |field: &str| {
        let field = field.trim();
        let mut words = field.split_whitespace();
        !field.starts_with(SIGNS)
            && !field.ends_with(SIGNS)
            && (words.clone().count() < 2 || !words.all(|word| number(word, true).is_some()))
    };
    row.contains('\t') && row.split('\t').all(is_whole)
}

/// The parts of a line between a sign that stands in no quotes. Quotes that do not come in pairs are signs as any other.
fn split_outside_quotes(line: &str, sign: char) -> Vec<&str> {
    let is_paired = line.matches('"').count().is_multiple_of(2);
    let mut is_quoted = false;
    line.split(|c: char| {
        is_quoted ^= c == '"' && is_paired;
        c == sign && !is_quoted
    })
    .collect()
}

/// A field without quotes, and a number without brackets; a name keeps its unit in brackets.
fn bare(field: &str) -> &str {
    let field = field.trim().trim_matches(['"', '\'']).trim();
    let is_name = field.chars().any(|c| c.is_alphabetic() && !matches!(c, 'e' | 'E'));
    if is_name { field } else { field.trim_matches(['(', ')', '[', ']']).trim() }
}

/// A line with its number in the file.
pub(super) type Line<'a> = (usize, &'a str);

/// A line without the white space around it, but with its tabs: an empty field may stand beside them.
fn trimmed(line: &str) -> &str {
    let is_space = |c: char| c.is_whitespace() && c != '\t';
    if line.trim().is_empty() { "" } else { line.trim_matches(is_space) }
}

/// The lines that are no comments, and the comments above the first of them, without their sign.
pub(super) fn split(text: &str) -> (Vec<Line<'_>>, Vec<Line<'_>>) {
    let (mut body, mut comments) = (Vec::new(), Vec::new());
    // Old Macs end a line with \r alone.
    let is_old = !text.contains('\n') && text.contains('\r');
    let lines: Vec<&str> = if is_old { text.split('\r').collect() } else { text.lines().collect() };
    for (index, content) in lines.into_iter().enumerate() {
        let (line, content) = (index + 1, trimmed(content));
        let quoted = content.trim_start().trim_start_matches('"');
        match COMMENTS.iter().find_map(|sign| quoted.strip_prefix(sign)) {
            Some(comment) if body.is_empty() => {
                comments.push((line, comment.trim_start_matches(['#', '/', '%']).trim()))
            }
            Some(_) => {}
            None if content.is_empty() => {}
            None => body.push((line, values(content))),
        }
    }
    (body, comments)
}

/// The values of a line, without a comment behind them, and without the sign that ends a row of MATLAB's. A sign that is a field, or
/// ends one, as of the name `Lap #`, begins no comment.
fn values(content: &str) -> &str {
    let is_comment = |at: &usize| !content[at + 2..].trim_start().starts_with([',', ';', '|']);
    let comment = content.match_indices(" #").map(|(at, _)| at).find(is_comment);
    let values = comment.map_or(content, |at| content[..at].trim_end());
    match values.strip_suffix(';') {
        Some(row) if !row.contains(';') && row.contains([',', ' ', '\t']) => row,
        _ => values,
    }
}

/// A number as it is written in a file; `comma` says that its decimals stand after a comma.
pub(super) fn number(field: &str, comma: bool) -> Option<f64> {
    if comma { field.replacen(',', ".", 1).parse().ok() } else { field.parse().ok() }
}
