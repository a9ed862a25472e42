//! What is wrong with a script, and where.

/// A script that can't be used. `what` says what was expected, what came and what to do.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{file}:{line}: {what}")]
pub struct ScriptError {
    /// File name as it was given to the parser.
    pub file: String,
    /// Line, from 1.
    pub line: usize,
    /// Expected, got, remedy.
    pub what: String,
}

/// The text of a script, to turn byte offsets into lines.
pub(crate) struct Source<'a> {
    pub file: &'a str,
    pub text: &'a str,
}

impl Source<'_> {
    pub fn line(&self, offset: usize) -> usize {
        let end = offset.min(self.text.len());
        1 + self.text.as_bytes()[..end].iter().filter(|&&byte| byte == b'\n').count()
    }

    pub fn error(&self, offset: usize, what: impl Into<String>) -> ScriptError {
        ScriptError { file: self.file.to_owned(), line: self.line(offset), what: what.into() }
    }
}
