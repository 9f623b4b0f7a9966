//! One picture: its surface, and the few marks that every picture is made of.
//!
//! Plotters uses whole pixels. The surface is therefore [`FINE`] times as large as the shown picture, so that curves
//! are smooth. Lines differ in dash pattern, width and marker, never only in colour, so that they can be distinguished
//! in print, too.

use plotters::backend::SVGBackend;
use plotters::coord::Shift;
use plotters::coord::cartesian::Cartesian2d;
use plotters::coord::types::RangedCoordf64;
use plotters::drawing::DrawingArea;
use plotters::element::{Circle, Drawable, PathElement, PointCollection, Polygon, Rectangle, Text};
use plotters::prelude::IntoDrawingArea;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use plotters::style::{
    Color, FontTransform, IntoFont, IntoTextStyle, RGBColor, ShapeStyle, TextStyle,
};

use crate::ReportError;
use crate::axis::{Axis, HUGE};

/// Steps of the surface in one shown pixel.
pub(crate) const FINE: f64 = 10.0;
/// Width of a picture that fills the page.
pub(crate) const WIDE: f64 = 960.0;
/// Width of a picture that shares its row with another.
pub(crate) const HALF: f64 = 470.0;
/// Room to the left of a plot, for the axis's ticks and name.
pub(crate) const LEFT: f64 = 68.0;
/// Room to the right: the last tick's label may be longer than the axis.
pub(crate) const RIGHT: f64 = 16.0;
/// Room below, for ticks and name.
pub(crate) const BOTTOM: f64 = 44.0;
/// Height of one row of the legend.
const LEGEND_ROW: f64 = 19.0;
/// Size of the letters.
const LETTER: f64 = 12.0;

pub(crate) const INK: RGBColor = RGBColor(0x1a, 0x1a, 0x1a);
pub(crate) const GREY: RGBColor = RGBColor(0x8a, 0x8a, 0x8a);
pub(crate) const PALE: RGBColor = RGBColor(0xe4, 0xe4, 0xe4);
pub(crate) const PAPER_WHITE: RGBColor = RGBColor(0xff, 0xff, 0xff);
pub(crate) const NAVY: RGBColor = RGBColor(0x0b, 0x3c, 0x6f);
pub(crate) const BLUE: RGBColor = RGBColor(0x4c, 0x86, 0xb8);
pub(crate) const ORANGE: RGBColor = RGBColor(0xe6, 0x88, 0x22);
/// Colours that colour-blind readers can distinguish, from dark to light.
pub(crate) const COLOURS: [RGBColor; 6] = [
    RGBColor(0x0b, 0x3c, 0x6f),
    RGBColor(0xc4, 0x4e, 0x00),
    RGBColor(0x00, 0x7f, 0x5f),
    RGBColor(0x9b, 0x4f, 0x96),
    RGBColor(0x3a, 0x9b, 0xd9),
    RGBColor(0x8a, 0x6d, 0x00),
];
/// Lengths of dash and gap, in shown pixels; the empty one is a solid line.
pub(crate) const DASHES: [&[f64]; 5] =
    [&[], &[8.0, 4.0], &[2.0, 3.0], &[11.0, 4.0, 2.0, 4.0], &[16.0, 5.0]];

/// The surface of a picture.
pub(crate) type Surface<'a> = DrawingArea<SVGBackend<'a>, Shift>;
type Drawn = Result<(), String>;

/// A finished picture.
#[derive(Debug)]
pub(crate) struct Picture {
    /// Name of its file, without extension.
    pub(crate) name: String,
    pub(crate) svg: String,
    /// Width at which its letters have the same size as those of the page.
    pub(crate) width: f64,
}

/// Draws one picture. `words` describes it for readers who cannot see it.
pub(crate) fn picture(
    name: &str,
    words: &str,
    (width, height): (f64, f64),
    draw: impl FnOnce(&Surface) -> Drawn,
) -> Result<Picture, ReportError> {
    let mut drawn = String::new();
    let size = (fine(width) as u32, fine(height) as u32);
    let outcome = {
        let surface = SVGBackend::with_string(&mut drawn, size).into_drawing_area();
        draw(&surface).and_then(|()| surface.present().map_err(|error| error.to_string()))
    };
    outcome.map_err(|problem| ReportError::Draw { picture: name.to_owned(), problem })?;
    // The library's own opening tag shows the picture ten times too large, and does not describe it.
    let inside = drawn.split_once('>').map_or("", |(_, inside)| inside);
    let head = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width:.0}\" height=\"{height:.0}\" viewBox=\"0 0 {} {}\" \
         role=\"img\" stroke-linejoin=\"round\">\n<title>{}</title>",
        size.0,
        size.1,
        escape(words),
    );
    Ok(Picture { name: name.to_owned(), svg: head + inside, width })
}

fn escape(text: &str) -> String {
    maud::html! { (text) }.into_string()
}

/// Shown pixels as steps of the surface.
pub(crate) fn fine(pixels: f64) -> i32 {
    (pixels * FINE).round() as i32
}

/// How a line looks.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Stroke {
    pub(crate) colour: RGBColor,
    pub(crate) width: f64,
    pub(crate) dash: &'static [f64],
    pub(crate) marker: Option<Marker>,
    /// Only markers, without the line between them.
    pub(crate) hidden: bool,
    /// A pale area within the line, without the line itself.
    pub(crate) area: bool,
}

impl Stroke {
    pub(crate) fn solid(colour: RGBColor, width: f64) -> Self {
        Self { colour, width, dash: DASHES[0], marker: None, hidden: false, area: false }
    }

    pub(crate) fn dashed(colour: RGBColor, width: f64, dash: &'static [f64]) -> Self {
        Self { dash, ..Self::solid(colour, width) }
    }

    /// The style of one of many lines: no two of the first thirty are the same in print.
    pub(crate) fn of_many(index: usize) -> Self {
        Self {
            colour: COLOURS[index % COLOURS.len()],
            width: 1.5,
            dash: DASHES[index % DASHES.len()],
            marker: Some(Marker::ALL[(index + index / Marker::ALL.len()) % Marker::ALL.len()]),
            hidden: false,
            area: false,
        }
    }
}

/// The marker at the points of a line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Marker {
    Disc,
    Square,
    Triangle,
    Diamond,
    Cross,
}

impl Marker {
    pub(crate) const ALL: [Self; 5] =
        [Self::Disc, Self::Square, Self::Triangle, Self::Diamond, Self::Cross];

    fn draw(self, surface: &Surface, at: (i32, i32), colour: RGBColor) -> Drawn {
        let radius = fine(3.2);
        let moved = |x: f64, y: f64| {
            let step = f64::from(radius);
            (at.0 + (x * step) as i32, at.1 + (y * step) as i32)
        };
        let corners: &[(f64, f64)] = match self {
            Self::Disc => {
                return put(surface, &Circle::new(at, radius, colour.filled()));
            }
            Self::Cross => {
                for (x, y) in [(1.0, 1.0), (1.0, -1.0)] {
                    let ends = vec![moved(-x, -y), moved(x, y)];
                    put(surface, &PathElement::new(ends, stroke(colour, 1.6)))?;
                }
                return Ok(());
            }
            Self::Square => &[(-0.9, -0.9), (0.9, -0.9), (0.9, 0.9), (-0.9, 0.9)],
            Self::Triangle => &[(0.0, -1.2), (1.1, 0.8), (-1.1, 0.8)],
            Self::Diamond => &[(0.0, -1.3), (1.3, 0.0), (0.0, 1.3), (-1.3, 0.0)],
        };
        let corners: Vec<_> = corners.iter().map(|&(x, y)| moved(x, y)).collect();
        put(surface, &Polygon::new(corners, colour.filled()))
    }
}

fn stroke(colour: RGBColor, width: f64) -> ShapeStyle {
    ShapeStyle { color: colour.to_rgba(), filled: false, stroke_width: fine(width) as u32 }
}

/// Puts one element onto the surface.
fn put<'s, 'e, E>(surface: &Surface<'s>, element: &'e E) -> Drawn
where
    &'e E: PointCollection<'e, (i32, i32)>,
    E: Drawable<SVGBackend<'s>>,
{
    surface.draw(element).map_err(|error| error.to_string())
}

/// Where a text is relative to its point.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Anchor {
    /// The text begins at the point.
    Start,
    /// Its middle is there.
    Middle,
    /// It ends there.
    End,
    /// Its middle is there, and it reads upwards.
    Upwards,
}

/// Writes a text, vertically centred on its point (in shown pixels).
pub(crate) fn write(surface: &Surface, text: &str, at: (f64, f64), anchor: Anchor) -> Drawn {
    let horizontal = match anchor {
        Anchor::Start => HPos::Left,
        Anchor::Middle | Anchor::Upwards => HPos::Center,
        Anchor::End => HPos::Right,
    };
    // The library's sizes are 1.24 times those of the letters.
    let mut font = ("sans-serif", LETTER * 1.24 * FINE).into_font();
    if matches!(anchor, Anchor::Upwards) {
        font = font.transform(FontTransform::Rotate270);
    }
    let style: TextStyle = font.into_text_style(surface).color(&INK);
    let style = style.pos(Pos::new(horizontal, VPos::Center));
    let text: String = text.chars().filter(|c| !c.is_control()).collect();
    let element = Text::new(text, (fine(at.0), fine(at.1)), style);
    put(surface, &element)
}

/// The approximate width of a text, in shown pixels: letters of the usual fonts are a little narrower.
pub(crate) fn text_width(text: &str) -> f64 {
    text.chars().count() as f64 * LETTER * 0.56
}

/// A straight line between two points of the surface, in shown pixels.
pub(crate) fn rule(surface: &Surface, from: (f64, f64), to: (f64, f64), look: &Stroke) -> Drawn {
    trace(surface, &[(fine(from.0), fine(from.1)), (fine(to.0), fine(to.1))], look)
}

/// A filled rectangle with a dark edge, in shown pixels.
pub(crate) fn block(
    surface: &Surface,
    corner: (f64, f64),
    opposite: (f64, f64),
    colour: RGBColor,
) -> Drawn {
    let corners = [(fine(corner.0), fine(corner.1)), (fine(opposite.0), fine(opposite.1))];
    put(surface, &Rectangle::new(corners, colour.filled()))?;
    let [(x0, y0), (x1, y1)] = corners;
    let edge = vec![(x0, y0), (x1, y0), (x1, y1), (x0, y1), (x0, y0)];
    put(surface, &PathElement::new(edge, stroke(INK, 0.6)))
}

/// A number in a circle.
pub(crate) fn badge(surface: &Surface, at: (f64, f64), text: &str) -> Drawn {
    let centre = (fine(at.0), fine(at.1));
    put(surface, &Circle::new(centre, fine(8.5), PAPER_WHITE.filled()))?;
    put(surface, &Circle::new(centre, fine(8.5), stroke(INK, 0.9)))?;
    write(surface, text, at, Anchor::Middle)
}

/// A line through points of the surface, cut into dashes if it has a pattern.
fn trace(surface: &Surface, points: &[(i32, i32)], look: &Stroke) -> Drawn {
    let style = stroke(look.colour, look.width);
    let dashes = if look.dash.is_empty() { vec![points.to_vec()] } else { cut(points, look.dash) };
    for dash in dashes {
        put(surface, &PathElement::new(dash, style))?;
    }
    Ok(())
}

/// Cuts a line into dashes.
fn cut(points: &[(i32, i32)], pattern: &[f64]) -> Vec<Vec<(i32, i32)>> {
    let mut dashes = Vec::new();
    let mut turn = 0;
    let mut left = pattern[0] * FINE;
    let mut dash: Vec<(i32, i32)> = points.first().copied().into_iter().collect();
    for pair in points.windows(2) {
        let (from, to) = (pair[0], pair[1]);
        let (dx, dy) = (f64::from(to.0) - f64::from(from.0), f64::from(to.1) - f64::from(from.1));
        let length = dx.hypot(dy);
        let mut gone = 0.0;
        while length - gone > left {
            gone += left;
            let share = gone / length;
            let at = (
                (f64::from(from.0) + share * dx).round() as i32,
                (f64::from(from.1) + share * dy).round() as i32,
            );
            if turn % 2 == 0 {
                dash.push(at);
                dashes.push(std::mem::take(&mut dash));
            } else {
                dash = vec![at];
            }
            turn += 1;
            left = pattern[turn % pattern.len()] * FINE;
        }
        left -= length - gone;
        if turn % 2 == 0 {
            dash.push(to);
        }
    }
    if turn % 2 == 0 && dash.len() > 1 {
        dashes.push(dash);
    }
    dashes
}

/// A legend above the plots, row by row, where it cannot cover a line.
pub(crate) struct Legend<'a> {
    rows: Vec<Vec<(f64, &'a str, Stroke)>>,
    /// Empty rows above.
    spare: usize,
}

impl<'a> Legend<'a> {
    /// Breaks the entries into rows that fit between `LEFT` and the right end of the picture.
    pub(crate) fn new(entries: impl IntoIterator<Item = (&'a str, Stroke)>, width: f64) -> Self {
        const SAMPLE: f64 = 34.0;
        let mut rows = vec![Vec::new()];
        let mut x = LEFT;
        for (label, look) in entries {
            let needed = SAMPLE + text_width(label) + 18.0;
            if x + needed - 18.0 > width && x > LEFT {
                rows.push(Vec::new());
                x = LEFT;
            }
            if let Some(row) = rows.last_mut() {
                row.push((x, label, look));
            }
            x += needed;
        }
        rows.retain(|row| !row.is_empty());
        Self { rows, spare: 0 }
    }

    /// The same legend with room for at least `rows` rows, so that plots side by side begin at the same height.
    pub(crate) fn at_least(self, rows: usize) -> Self {
        Self { spare: rows.saturating_sub(self.rows.len()), ..self }
    }

    /// Room that it takes above the plots.
    pub(crate) fn height(&self) -> f64 {
        (self.spare + self.rows.len()) as f64 * LEGEND_ROW + 10.0
    }

    pub(crate) fn draw(&self, surface: &Surface) -> Drawn {
        for (index, row) in self.rows.iter().enumerate() {
            let y = 12.0 + (self.spare + index) as f64 * LEGEND_ROW;
            for (x, label, look) in row {
                if !look.hidden {
                    // In a plot, many hairlines together are visible; a single one in the legend would not be.
                    let look = Stroke { width: look.width.max(1.0), ..*look };
                    rule(surface, (*x, y), (x + 28.0, y), &look)?;
                }
                if let Some(marker) = look.marker {
                    marker.draw(surface, (fine(x + 14.0), fine(y)), look.colour)?;
                }
                write(surface, label, (x + 34.0, y), Anchor::Start)?;
            }
        }
        Ok(())
    }
}

/// Where a plot lies within its picture, in shown pixels.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Frame {
    pub(crate) left: f64,
    pub(crate) top: f64,
    pub(crate) width: f64,
    pub(crate) height: f64,
}

/// A frame with axes, into which lines are drawn.
pub(crate) struct Plot<'s, 'a> {
    surface: &'s Surface<'a>,
    coord: Cartesian2d<RangedCoordf64, RangedCoordf64>,
    frame: Frame,
}

impl<'s, 'a> Plot<'s, 'a> {
    /// Draws grid, frame and ticks. An empty name leaves the labels of that axis out.
    pub(crate) fn new(
        surface: &'s Surface<'a>,
        frame: Frame,
        (x, x_name): (&Axis, &str),
        (y, y_name): (&Axis, &str),
    ) -> Result<Self, String> {
        let Frame { left, top, width, height } = frame;
        let (right, bottom) = (left + width, top + height);
        let coord = Cartesian2d::<RangedCoordf64, RangedCoordf64>::new(
            ranged(x),
            ranged(y),
            (fine(left)..fine(right), fine(bottom)..fine(top)),
        );
        let plot = Self { surface, coord, frame };
        let grid = Stroke::solid(PALE, 0.8);
        let mark = Stroke::solid(INK, 0.9);
        for (value, label) in &x.ticks {
            let at = f64::from(plot.pixel((*value, y.low)).0) / FINE;
            rule(surface, (at, top), (at, bottom), &grid)?;
            rule(surface, (at, bottom), (at, bottom + 4.0), &mark)?;
            // A long label at the end of the axis is moved inwards, so that it stays in the picture.
            let most = right + RIGHT - 1.0 - 0.5 * text_width(label);
            write(surface, label, (at.min(most), bottom + 13.0), Anchor::Middle)?;
        }
        for (value, label) in &y.ticks {
            let at = f64::from(plot.pixel((x.low, *value)).1) / FINE;
            rule(surface, (left, at), (right, at), &grid)?;
            if !y_name.is_empty() {
                rule(surface, (left - 4.0, at), (left, at), &mark)?;
                write(surface, label, (left - 7.0, at), Anchor::End)?;
            }
        }
        for (from, to) in [
            ((left, top), (right, top)),
            ((right, top), (right, bottom)),
            ((left, bottom), (right, bottom)),
            ((left, top), (left, bottom)),
        ] {
            rule(surface, from, to, &mark)?;
        }
        write(surface, x_name, (left + 0.5 * width, bottom + 33.0), Anchor::Middle)?;
        if !y_name.is_empty() {
            write(surface, y_name, (left - LEFT + 11.0, top + 0.5 * height), Anchor::Upwards)?;
        }
        Ok(plot)
    }

    fn pixel(&self, point: (f64, f64)) -> (i32, i32) {
        use plotters::coord::CoordTranslate;
        // Values beyond the axes would overflow the library's arithmetic.
        self.coord.translate(&(point.0.clamp(-HUGE, HUGE), point.1.clamp(-HUGE, HUGE)))
    }

    /// A point of the plot in shown pixels.
    pub(crate) fn place(&self, point: (f64, f64)) -> (f64, f64) {
        let (x, y) = self.pixel(point);
        (f64::from(x) / FINE, f64::from(y) / FINE)
    }

    /// A line through points, with its markers.
    pub(crate) fn line(&self, points: &[(f64, f64)], look: &Stroke) -> Drawn {
        let pixels: Vec<_> = points.iter().map(|&point| self.pixel(point)).collect();
        if look.area {
            return put(self.surface, &Polygon::new(pixels, look.colour.mix(0.15).filled()));
        }
        if !look.hidden && pixels.len() > 1 {
            trace(self.surface, &pixels, look)?;
        }
        if pixels.len() == 1 && look.marker.is_none() {
            // A line of one point would be invisible.
            Marker::Disc.draw(self.surface, pixels[0], look.colour)?;
        }
        for &at in pixels.iter().filter(|_| look.marker.is_some()) {
            look.marker.map_or(Ok(()), |marker| marker.draw(self.surface, at, look.colour))?;
        }
        Ok(())
    }

    /// Lines from bottom to top, each with its number above it.
    pub(crate) fn verticals(&self, lines: &[(f64, String)], look: &Stroke) -> Drawn {
        let Frame { top, height, .. } = self.frame;
        let mut free = f64::NEG_INFINITY;
        for (x, label) in lines {
            let at = f64::from(self.pixel((*x, 0.0)).0) / FINE;
            rule(self.surface, (at, top), (at, top + height), look)?;
            // The numbers of lines that are close to each other are in a row, in the order of the lines.
            let beside = at.max(free);
            badge(self.surface, (beside, top - 10.0), label)?;
            free = beside + 18.0;
        }
        Ok(())
    }
}

fn ranged(axis: &Axis) -> RangedCoordf64 {
    (axis.low..axis.high).into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dashes_have_the_length_of_their_pattern() {
        let dashes = cut(&[(0, 0), (150, 0), (300, 0)], &[8.0, 4.0]);
        assert_eq!(dashes[0], [(0, 0), (80, 0)]);
        assert_eq!(dashes[1], [(120, 0), (150, 0), (200, 0)]);
        assert_eq!(dashes.last(), Some(&vec![(240, 0), (300, 0)]));
        assert!(cut(&[], &[8.0, 4.0]).is_empty() && cut(&[(1, 1)], &[8.0, 4.0]).is_empty());
    }
}
