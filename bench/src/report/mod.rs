//! The self-contained report: one HTML file with interactive figures that opens without a network.
//!
//! The same input gives the same bytes: no date, no path, no hash order enters the page.

mod data;
mod decimate;
mod html;

use identify::figure::{Figure, Table};
use std::collections::BTreeSet;
use std::fmt::Write;

const UPLOT_JS: &str = include_str!("../../assets/uplot/uPlot.iife.min.js");
const UPLOT_CSS: &str = include_str!("../../assets/uplot/uPlot.min.css");
const UPLOT_LICENSE: &str = include_str!("../../assets/uplot/LICENSE");
const PAGE_CSS: &str = include_str!("../../assets/report.css");
const PAGE_JS: &str = include_str!("../../assets/report.js");

/// What a report shows.
#[derive(Clone, Debug, Default)]
pub struct Report {
    /// Head of the page.
    pub title: String,
    /// First the verdict in one sentence, then a few key facts, one a line.
    pub headline: Vec<String>,
    /// Figures; those of a section stand together.
    pub figures: Vec<Figure>,
    /// Tables; within a section they stand before its figures.
    pub tables: Vec<Table>,
}

/// The page. Sections that hold tables only come first, then those of the figures, each kind in order of first appearance.
/// A series whose `x` and `y` differ in length is drawn as far as both go, with a notice in the page.
pub fn render(report: &Report) -> String {
    let sections = sections(report);
    let anchors = anchors(&report.figures);
    let title = html::escape(&report.title);

    let mut page = String::new();
    let _ = write!(
        page,
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; style-src 'unsafe-inline'; \
         script-src 'unsafe-inline'; img-src data:\">\n<link rel=\"icon\" href=\"data:,\">\n<title>{title}</title>\n\
         <style>{UPLOT_CSS}</style>\n<style>\n{PAGE_CSS}</style>\n</head>\n<body>\n<header>\n<h1>{title}</h1>\n"
    );
    html::headline(&mut page, &report.headline);
    page.push_str("</header>\n");
    html::navigation(&mut page, &sections);
    page.push_str(
        "<main>\n<noscript><p class=\"fault\">The figures need JavaScript; the tables do not.</p></noscript>\n",
    );
    for (i, section) in sections.iter().enumerate() {
        let _ = writeln!(page, "<h2 id=\"section-{}\">{}</h2>", i + 1, html::escape(section));
        for table in report.tables.iter().filter(|t| t.section == *section) {
            html::table(&mut page, table);
        }
        for (index, figure) in report.figures.iter().enumerate().filter(|(_, f)| f.section == *section) {
            html::figure(&mut page, figure, index, &anchors[index]);
        }
    }
    let _ = write!(
        page,
        "</main>\n<footer>Drag to zoom, double-click or “all” to go back, ctrl + wheel or two fingers to zoom at a place; click a \
         name to hide a series. Long series are thinned for display; extremes stay.</footer>\n\
         <script type=\"application/json\" id=\"figures\">{}</script>\n\
         <script>/* uPlot\n{UPLOT_LICENSE}\n*/\n{UPLOT_JS}</script>\n<script>\n{PAGE_JS}</script>\n</body>\n</html>\n",
        data::json(&report.figures)
    );
    page
}

/// Sections of the page in their order, each once.
fn sections(report: &Report) -> Vec<&str> {
    let drawn: BTreeSet<&str> = report.figures.iter().map(|f| f.section.as_str()).collect();
    let tables = report.tables.iter().map(|t| t.section.as_str()).filter(|s| !drawn.contains(s));
    let mut out: Vec<&str> = Vec::new();
    for section in tables.chain(report.figures.iter().map(|f| f.section.as_str())) {
        if !out.contains(&section) {
            out.push(section);
        }
    }
    out
}

/// One anchor a figure; an id that was used before gets a number.
fn anchors(figures: &[Figure]) -> Vec<String> {
    let mut used = BTreeSet::new();
    figures
        .iter()
        .map(|f| {
            let mut anchor = f.id.clone();
            let mut n = 2;
            while !used.insert(anchor.clone()) {
                anchor = format!("{}-{n}", f.id);
                n += 1;
            }
            anchor
        })
        .collect()
}
