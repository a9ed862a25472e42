//! The parts of the page. Every text that comes from outside passes [`escape`].

use identify::figure::{Figure, Table};
use std::fmt::Write;

/// `text` for use in HTML, between tags and in quoted attributes.
pub fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            // Control characters have no place in HTML; shown, not dropped.
            c if c.is_control() && !matches!(c, '\n' | '\t') => out.push('\u{fffd}'),
            c => out.push(c),
        }
    }
    out
}

/// The verdict and the key facts at the top: the first line is the verdict.
pub fn headline(out: &mut String, lines: &[String]) {
    let Some((verdict, facts)) = lines.split_first() else { return };
    let _ = writeln!(out, "<p class=\"verdict\">{}</p>", escape(verdict));
    if !facts.is_empty() {
        out.push_str("<ul class=\"facts\">\n");
        for fact in facts {
            let _ = writeln!(out, "<li>{}</li>", escape(fact));
        }
        out.push_str("</ul>\n");
    }
}

/// Links to the sections.
pub fn navigation(out: &mut String, sections: &[&str]) {
    out.push_str("<nav aria-label=\"sections\"><ul>\n");
    for (i, section) in sections.iter().enumerate() {
        let _ = writeln!(out, "<li><a href=\"#section-{}\">{}</a></li>", i + 1, escape(section));
    }
    out.push_str("</ul></nav>\n");
}

/// A table; cells that are numbers stand to the right.
pub fn table(out: &mut String, table: &Table) {
    let _ = writeln!(out, "<h3>{}</h3>", escape(&table.title));
    caption(out, &table.caption);
    out.push_str("<div class=\"scroll\"><table>\n<thead><tr>");
    for column in &table.columns {
        let _ = write!(out, "<th scope=\"col\">{}</th>", escape(column));
    }
    out.push_str("</tr></thead>\n<tbody>\n");
    for row in &table.rows {
        out.push_str("<tr>");
        for cell in row {
            let class = if cell.trim().parse::<f64>().is_ok() { " class=\"number\"" } else { "" };
            let _ = write!(out, "<td{class}>{}</td>", escape(cell));
        }
        out.push_str("</tr>\n");
    }
    out.push_str("</tbody></table></div>\n");
}

/// Title, caption and the place where the script draws figure number `index`; `anchor` is unique in the page.
pub fn figure(out: &mut String, figure: &Figure, index: usize, anchor: &str) {
    let _ = writeln!(
        out,
        "<section class=\"figure\" id=\"figure-{}\">\n<h3>{}</h3>",
        escape(anchor),
        escape(&figure.title)
    );
    caption(out, &figure.caption);
    for s in figure.series.iter().filter(|s| s.x.len() != s.y.len()) {
        let _ = writeln!(
            out,
            "<p class=\"fault\">Series {}: {} abscissae but {} ordinates; only the first {} values are drawn.</p>",
            escape(&s.name),
            s.x.len(),
            s.y.len(),
            s.x.len().min(s.y.len())
        );
    }
    let _ = writeln!(out, "<div class=\"plot\" data-figure=\"{index}\"></div>\n</section>");
}

fn caption(out: &mut String, text: &str) {
    if !text.is_empty() {
        let _ = writeln!(out, "<p class=\"caption\">{}</p>", escape(text));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_gets_out_of_a_text_or_an_attribute() {
        assert_eq!(escape("<b a=\"x\" c='y'>&\u{7}"), "&lt;b a=&quot;x&quot; c=&#39;y&#39;&gt;&amp;\u{fffd}");
        assert_eq!(escape("φ / °, Δp\n"), "φ / °, Δp\n");
    }

    #[test]
    fn only_numbers_stand_to_the_right() {
        let t = Table {
            section: "s".into(),
            title: "t".into(),
            caption: String::new(),
            columns: vec!["run".into(), "RMSE / bar".into()],
            rows: vec![vec!["square_h".into(), "1.3e-2".into()]],
        };
        let mut out = String::new();
        table(&mut out, &t);
        assert!(out.contains("<td>square_h</td><td class=\"number\">1.3e-2</td>"));
        assert!(!out.contains("caption"));
    }
}
