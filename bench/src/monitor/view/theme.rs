//! Colours, and what stands in their place where there are none.

use ratatui::style::{Color, Modifier, Style};
use ratatui::symbols::Marker;
use recordings::Severity;

/// See the module.
pub(super) struct Theme {
    colour: bool,
}

impl Theme {
    pub fn new(colour: bool) -> Theme {
        Theme { colour }
    }

    fn coloured(&self, style: Style, colour: Color) -> Style {
        if self.colour { style.fg(colour) } else { style }
    }

    /// The word that says where things stand; `None`: nothing is under way.
    pub fn badge(&self, severity: Option<Severity>) -> Style {
        let style = Style::new().add_modifier(Modifier::REVERSED | Modifier::BOLD);
        match severity {
            None => style,
            Some(severity) => self.coloured(style, Self::colour_of(severity)),
        }
    }

    fn colour_of(severity: Severity) -> Color {
        match severity {
            Severity::Info => Color::Green,
            Severity::Warning => Color::Yellow,
            Severity::Error => Color::Red,
        }
    }

    /// Text that says how bad something is.
    pub fn said(&self, severity: Severity) -> Style {
        match severity {
            Severity::Info => Style::new(),
            Severity::Warning | Severity::Error => self.coloured(self.strong(), Self::colour_of(severity)),
        }
    }

    pub fn strong(&self) -> Style {
        Style::new().add_modifier(Modifier::BOLD)
    }

    pub fn quiet(&self) -> Style {
        Style::new().add_modifier(Modifier::DIM)
    }

    pub fn key(&self) -> Style {
        Style::new().add_modifier(Modifier::REVERSED)
    }

    /// What the profile asks for: dots, also where there are colours.
    pub fn target(&self) -> (Style, Marker) {
        (self.coloured(Style::new(), Color::Magenta), Marker::Dot)
    }

    /// The curve with this number in its picture. Without colours the second is made of larger dots.
    pub fn curve(&self, number: usize) -> (Style, Marker) {
        let colour = [Color::Cyan, Color::Yellow][number % 2];
        let marker = if number == 0 || self.colour { Marker::Braille } else { Marker::Dot };
        (self.coloured(Style::new(), colour), marker)
    }
}

/// A letter before a happening, so that its severity is seen without colour.
pub(super) fn sign(severity: Severity) -> &'static str {
    match severity {
        Severity::Info => " ",
        Severity::Warning => "!",
        Severity::Error => "X",
    }
}

/// How a curve of this marker looks like in a legend.
pub(super) fn legend(marker: Marker) -> &'static str {
    if marker == Marker::Braille { "⠒⠒" } else { "••" }
}
