//! The text of `campaign.toml`. Every known key is required, so a misspelled one is always reported as missing; keys
//! that are not known are therefore accepted everywhere, which lets other tools and later versions add theirs.

use std::collections::HashMap;
use std::fmt::Write;
use std::ops::Range;
use std::path::{Component, Path, PathBuf};
use std::str::FromStr;

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use crate::error::{Place, quoted};
use crate::recording::{EXTENSIONS, FileKind};
use crate::vocabulary::UnknownWord;
use crate::{CampaignError, RigFacts, RunEntry};

/// The format number that is written, and the only one that is read.
const FORMAT: &str = "1";

/// What the file says, and where it names each run's file.
pub(crate) struct Parsed {
    pub name: String,
    pub rig: RigFacts,
    pub runs: Vec<RunEntry>,
    pub places: Vec<Place>,
}

/// Reads the text; `path` is only for messages.
pub(crate) fn parse(path: &Path, text: &str) -> Result<Parsed, CampaignError> {
    let document = Document { path, text };
    let table = DeTable::parse(text).map_err(|error| {
        let at = document.at(error.span().unwrap_or(0..0));
        CampaignError::content(at, "valid TOML", error.message().replace('\n', ", "), "correct the line")
    })?;
    let top = Section { document: &document, name: "campaign".to_owned(), span: 0..0, table: table.get_ref() };

    let format = top.required("format")?;
    if format.get_ref().as_integer().is_none_or(|number| number.as_str() != FORMAT) {
        let remedy = format!("this version reads format {FORMAT}; convert the campaign or use the matching version");
        return Err(document.fault(format, "format", &format!("the number {FORMAT}"), remedy));
    }
    let (name, _) = top.text("name")?;
    let rig = top.section("rig", "a table [rig]")?;
    let facts = RigFacts {
        inertia_kg_m2: rig.number("J", "a number > 0 (kg m2)", |value| value > 0.0)?,
        gravity_nm: rig.number("G", "a number >= 0 (Nm)", |value| value >= 0.0)?,
        u_max_v: rig.number("u_max", "a number > 0 (V)", |value| value > 0.0)?,
    };

    let list = top.required("run")?;
    let entries = list.get_ref().as_array().filter(|entries| !entries.is_empty());
    let Some(entries) = entries else {
        return Err(document.fault(
            list,
            "run",
            "at least one table [[run]]",
            "name each recording in a table [[run]]",
        ));
    };
    let (mut runs, mut places) = (Vec::new(), Vec::new());
    let mut seen: HashMap<PathBuf, Place> = HashMap::new();
    for (index, entry) in entries.iter().enumerate() {
        let Some(table) = entry.get_ref().as_table() else {
            return Err(document.fault(entry, "run", "a table [[run]]", "write one table [[run]] a recording"));
        };
        let name = format!("run {}", index + 1);
        let section = Section { document: &document, name, span: entry.span(), table };
        let (run, at, inside) = section.run()?;
        if let Some(before) = seen.insert(inside, at.clone()) {
            let got = format!("{:?} again, first named at {before}", run.file);
            return Err(CampaignError::content(at, "each file once", got, "remove one of the two runs"));
        }
        runs.push(run);
        places.push(at);
    }
    Ok(Parsed { name, rig: facts, runs, places })
}

/// The text that [`parse`] reads back as the same values.
pub(crate) fn render(name: &str, rig: &RigFacts, runs: &[RunEntry]) -> String {
    let quote = |text: &str| toml::Value::String(text.to_owned()).to_string();
    let float = |value: f64| toml::Value::Float(value).to_string();
    let mut text = format!("format = {FORMAT}\nname = {}\n\n[rig]\n", quote(name));
    let facts = [("J", rig.inertia_kg_m2, "kg m2"), ("G", rig.gravity_nm, "Nm"), ("u_max", rig.u_max_v, "V")];
    for (key, value, unit) in facts {
        let _ = writeln!(text, "{key} = {} # {unit}", float(value)); // writing to a String can't fail
    }
    for run in runs {
        let words = (quote(&run.file), run.protocol, run.role, run.plane);
        let _ = write!(
            text,
            "\n[[run]]\nfile = {}\nprotocol = \"{}\"\nrole = \"{}\"\nplane = \"{}\"\n",
            words.0, words.1, words.2, words.3
        );
    }
    text
}

struct Document<'d> {
    path: &'d Path,
    text: &'d str,
}

impl Document<'_> {
    fn at(&self, span: Range<usize>) -> Place {
        let before = &self.text.as_bytes()[..span.start.min(self.text.len())];
        Place::file(self.path).line(1 + before.iter().filter(|&&byte| byte == b'\n').count() as u64)
    }

    fn fault(
        &self,
        value: &Spanned<DeValue<'_>>,
        key: &str,
        expected: &str,
        remedy: impl Into<String>,
    ) -> CampaignError {
        let got = quoted(self.text[value.span()].as_bytes());
        CampaignError::content(self.at(value.span()).column(key), expected, got, remedy)
    }
}

/// A table of the document, and how it is called.
struct Section<'d> {
    document: &'d Document<'d>,
    name: String,
    span: Range<usize>,
    table: &'d DeTable<'d>,
}

impl<'d> Section<'d> {
    fn required(&self, key: &str) -> Result<&'d Spanned<DeValue<'d>>, CampaignError> {
        self.table.get(key).ok_or_else(|| {
            let keys: Vec<_> = self.table.keys().map(|key| key.get_ref().as_ref()).collect();
            let got = if keys.is_empty() { "none at all".to_owned() } else { format!("only {}", keys.join(", ")) };
            let at = self.document.at(self.span.clone()).column(key);
            let expected = format!("the key \"{key}\" in [{}]", self.name);
            CampaignError::content(at, expected, got, "add the key")
        })
    }

    fn section(&self, key: &str, expected: &str) -> Result<Section<'d>, CampaignError> {
        let value = self.required(key)?;
        let table = value.get_ref().as_table();
        let table = table.ok_or_else(|| self.document.fault(value, key, expected, "write it as a table"))?;
        Ok(Section { document: self.document, name: key.to_owned(), span: value.span(), table })
    }

    fn text(&self, key: &str) -> Result<(String, &'d Spanned<DeValue<'d>>), CampaignError> {
        let value = self.required(key)?;
        match value.get_ref().as_str() {
            Some(text) => Ok((text.to_owned(), value)),
            None => Err(self.document.fault(value, key, "text in quotes", "put the value in quotes")),
        }
    }

    fn number(&self, key: &str, expected: &str, allowed: fn(f64) -> bool) -> Result<f64, CampaignError> {
        let value = self.required(key)?;
        let number: Option<f64> = match value.get_ref() {
            DeValue::Float(float) => float.as_str().parse().ok(),
            DeValue::Integer(integer) if integer.radix() == 10 => integer.as_str().parse().ok(),
            _ => None,
        };
        number
            .filter(|number| number.is_finite() && allowed(*number))
            .ok_or_else(|| self.document.fault(value, key, expected, "correct the value"))
    }

    fn word<T: FromStr<Err = UnknownWord>>(&self, key: &str) -> Result<T, CampaignError> {
        let (word, value) = self.text(key)?;
        word.parse().map_err(|unknown: UnknownWord| {
            let expected = format!("a {} ({})", unknown.what, unknown.allowed);
            self.document.fault(value, key, &expected, "choose one of these words")
        })
    }

    /// The run, the place of its file's name, and the file's path inside the folder without `.` components.
    fn run(&self) -> Result<(RunEntry, Place, PathBuf), CampaignError> {
        let (file, value) = self.text("file")?;
        let fault = |expected: &str, remedy: &str| Err(self.document.fault(value, "file", expected, remedy));
        if FileKind::of_name(&file).is_none() {
            return fault(&format!("a file name that ends in {EXTENSIONS}"), "name the recording by what it is");
        }
        let mut inside = PathBuf::new();
        for component in Path::new(&file).components() {
            match component {
                Component::CurDir => {}
                Component::Normal(name) => inside.push(name),
                _ => {
                    return fault("a path inside the campaign's folder", "copy the recording into the folder");
                }
            }
        }
        let entry =
            RunEntry { protocol: self.word("protocol")?, role: self.word("role")?, plane: self.word("plane")?, file };
        Ok((entry, self.document.at(value.span()).column("file"), inside))
    }
}
