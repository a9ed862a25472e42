//! The token of who may command: read from a file that only its owner may read, or drawn and written to one.

use crate::failure::{Failure, Kind};
use rand::TryRngCore;
use rand::rngs::OsRng;
use rt_core::link::validate_instance;
use std::fmt;
use std::fs::{self, DirBuilder, OpenOptions};
use std::io::Write;
use std::os::unix::fs::{DirBuilderExt, MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use subtle::ConstantTimeEq;

/// Characters of a token at least.
const SHORTEST: usize = 16;
/// Bytes of one that is drawn.
const DRAWN: usize = 24;

/// See the module. It is not shown by `Debug`.
pub struct Token {
    secret: String,
    /// Where it can be read.
    pub file: PathBuf,
    /// The file was written here, and goes with the service.
    drawn: bool,
}

impl fmt::Debug for Token {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Token").field("file", &self.file).finish_non_exhaustive()
    }
}

impl Token {
    /// The token of this file.
    ///
    /// # Errors
    /// It is not there, others may read it, it is too short (2).
    pub fn read(file: &Path) -> Result<Token, Failure> {
        let wrong = |what: String| Failure::new(Kind::Input, format!("--token-file {}: {what}", file.display()));
        let metadata = fs::metadata(file).map_err(|error| {
            wrong(format!("expected a file with the token, got \"{error}\"; leave the option out to have one drawn"))
        })?;
        if metadata.mode() & 0o077 != 0 {
            let mode = metadata.mode() & 0o777;
            let what = format!("expected a file that only its owner may read, got mode {mode:o}; chmod 600 it");
            return Err(wrong(what));
        }
        let text = fs::read_to_string(file).map_err(|error| wrong(format!("expected text, got \"{error}\"")))?;
        let secret = text.trim().to_owned();
        let plain = |byte: u8| byte.is_ascii_graphic();
        if secret.len() < SHORTEST || !secret.bytes().all(plain) {
            let what =
                format!("expected at least {SHORTEST} printable ASCII characters without spaces; make a new one");
            return Err(wrong(what));
        }
        Ok(Token { secret, file: file.to_owned(), drawn: false })
    }

    /// A new one, in a file of the user's runtime folder. What an earlier service of this instance left there is replaced.
    ///
    /// # Errors
    /// A name that is none: it becomes part of the path (2). No random numbers, no place for the file (1).
    pub fn draw(instance: &str) -> Result<Token, Failure> {
        validate_instance(instance).map_err(|error| Failure::of(Kind::Input, &error))?;
        let failed = |what: String| Failure::new(Kind::Internal, format!("{what}; give one by --token-file"));
        let mut bytes = [0_u8; DRAWN];
        OsRng.try_fill_bytes(&mut bytes).map_err(|error| failed(format!("no random token: {error}")))?;
        let secret = bytes.iter().map(|byte| format!("{byte:02x}")).collect::<String>();
        let folder = runtime_folder().map_err(|error| failed(format!("no folder for the token: {error}")))?;
        let file = folder.join(format!("{instance}.token"));
        let written = |error: std::io::Error| failed(format!("{}: {error}", file.display()));
        // Never written into a file that somebody else may have opened.
        match fs::remove_file(&file) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => return Err(written(error)),
            _ => {}
        }
        let opened = OpenOptions::new().write(true).create_new(true).mode(0o600).open(&file);
        opened.and_then(|mut out| writeln!(out, "{secret}")).map_err(written)?;
        Ok(Token { secret, file, drawn: true })
    }

    /// Whether this is it; how long that takes says nothing about it.
    pub fn is(&self, said: &str) -> bool {
        self.secret.as_bytes().ct_eq(said.as_bytes()).into()
    }

    /// For the address that the owner is told.
    pub fn reveal(&self) -> &str {
        &self.secret
    }
}

impl Drop for Token {
    fn drop(&mut self) {
        // It is worth nothing any more. Another one that a later service wrote there is.
        if self.drawn && fs::read_to_string(&self.file).is_ok_and(|text| text.trim() == self.secret) {
            let _ = fs::remove_file(&self.file);
        }
    }
}

/// A folder that only this user can enter: the service manager's, the session's, or one of our own among the temporary ones.
fn runtime_folder() -> std::io::Result<PathBuf> {
    if let Some(folder) = std::env::var_os("RUNTIME_DIRECTORY") {
        return Ok(PathBuf::from(folder));
    }
    let user = rustix::process::geteuid().as_raw();
    let folder = match std::env::var_os("XDG_RUNTIME_DIR") {
        Some(session) => PathBuf::from(session).join("rec-bench"),
        None => std::env::temp_dir().join(format!("rec-bench-{user}")),
    };
    match DirBuilder::new().mode(0o700).create(&folder) {
        Err(error) if error.kind() != std::io::ErrorKind::AlreadyExists => return Err(error),
        _ => {}
    }
    // Among the temporary files anybody may have made it.
    let metadata = fs::symlink_metadata(&folder)?;
    if !metadata.is_dir() || metadata.uid() != user || metadata.mode() & 0o077 != 0 {
        let what =
            format!("{}: expected a folder of this user that nobody else may enter; remove it", folder.display());
        return Err(std::io::Error::other(what));
    }
    Ok(folder)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::PermissionsExt;

    #[test]
    fn a_file_that_others_may_read_or_that_holds_no_token_is_refused() {
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("token");
        let put = |text: &str, mode: u32| {
            fs::write(&file, text).expect("written");
            fs::set_permissions(&file, fs::Permissions::from_mode(mode)).expect("its mode");
            Token::read(&file)
        };
        for mode in [0o644, 0o640, 0o604] {
            let failure = put("0123456789abcdef", mode).expect_err("others may read it");
            assert!(failure.exit_code() == 2 && failure.message.contains("chmod 600"), "{failure}");
        }
        assert!(put("short", 0o600).is_err());
        assert!(put("0123456789 abcdef", 0o600).is_err());
        let token = put("0123456789abcdef\n", 0o600).expect("it is one");
        assert!(token.is("0123456789abcdef"));
        for other in ["", "0123456789abcde", "0123456789abcdeg", "0123456789abcdef0"] {
            assert!(!token.is(other), "{other:?}");
        }
        assert!(!format!("{token:?}").contains("0123456789abcdef"), "it is not shown");
        drop(token);
        assert!(file.exists(), "the owner's file is left alone");
        assert!(Token::read(&folder.path().join("none")).is_err());
    }

    #[test]
    fn a_drawn_token_is_new_private_and_goes_with_the_service() {
        let instance = format!("token-test-{}", std::process::id());
        let first = Token::draw(&instance).expect("it is drawn");
        let said = first.reveal().to_owned();
        let mode = fs::metadata(&first.file).expect("it is there").mode() & 0o777;
        assert_eq!((said.len(), mode), (2 * DRAWN, 0o600));
        assert_eq!(fs::read_to_string(&first.file).expect("text").trim(), said);
        let file = first.file.clone();
        drop(first);
        assert!(!file.exists());
        let second = Token::draw(&instance).expect("it is drawn");
        assert!(!second.is(&said));
        let third = Token::draw(&instance).expect("it is drawn");
        drop(second);
        assert_eq!(fs::read_to_string(&third.file).expect("another's is left alone").trim(), third.reveal());
    }

    #[test]
    fn a_name_that_would_leave_its_folder_is_refused() {
        let failure = Token::draw("../elsewhere").expect_err("no name");
        assert!(failure.exit_code() == 2 && failure.message.contains("instance name"), "{failure}");
    }
}
