//! A value inside a model's file with its place, for messages that name both.

use super::ModelError;
use serde_json::Value;

/// Returns "one of a, b, c".
pub(super) fn one_of(names: &[&str]) -> String {
    format!("one of {}", names.join(", "))
}

/// Returns the place of a key inside the object at `path`.
pub(super) fn inside(path: &str, key: &str) -> String {
    if path.is_empty() { key.to_owned() } else { format!("{path}.{key}") }
}

/// Returns the value at the place, as far as it fits a sentence.
fn shown(value: &Value) -> String {
    const MOST: usize = 60;
    let text = value.to_string();
    if text.chars().count() <= MOST { text } else { text.chars().take(MOST).chain(['…']).collect() }
}

/// A value and its place.
pub(super) struct Place<'a> {
    pub(super) file: &'a str,
    pub(super) path: String,
    /// The last key of the path; it may contain a dot.
    key: String,
    pub(super) value: &'a Value,
}

impl<'a> Place<'a> {
    /// Returns the place of the whole file.
    pub(super) fn root(file: &'a str, value: &'a Value) -> Self {
        Self { file, path: String::new(), key: String::new(), value }
    }
    fn child(&self, key: &str, value: &'a Value) -> Self {
        Self { file: self.file, path: inside(&self.path, key), key: key.to_owned(), value }
    }
    pub(super) fn optional(&self, key: &str) -> Option<Self> {
        self.value.get(key).map(|value| self.child(key, value))
    }
    pub(super) fn key(&self, key: &str, meaning: &str) -> Result<Self, ModelError> {
        self.optional(key).ok_or_else(|| ModelError::Content {
            file: self.file.to_owned(),
            path: self.shown_path(),
            found: format!("no `{key}`"),
            expected: format!("`{key}`: {meaning}"),
        })
    }
    pub(super) fn last_key(&self) -> &str {
        &self.key
    }
    pub(super) fn entries(&self, expected: &str) -> Result<Vec<Self>, ModelError> {
        let object = self.value.as_object().ok_or_else(|| self.refuse(expected))?;
        Ok(object.iter().map(|(key, value)| self.child(key, value)).collect())
    }
    pub(super) fn items(&self, expected: &str) -> Result<Vec<Self>, ModelError> {
        let list = self.value.as_array().ok_or_else(|| self.refuse(expected))?;
        let item = |(index, value)| Self {
            file: self.file,
            path: format!("{}[{index}]", self.path),
            key: self.key.clone(),
            value,
        };
        Ok(list.iter().enumerate().map(item).collect())
    }
    pub(super) fn only_keys(&self, allowed: &[&str]) -> Result<(), ModelError> {
        match self.entries("an object")?.iter().find(|entry| !allowed.contains(&entry.last_key())) {
            None => Ok(()),
            Some(unknown) => Err(unknown.refuse_key(&one_of(allowed))),
        }
    }
    pub(super) fn number(&self) -> Result<f64, ModelError> {
        self.value.as_f64().filter(|number| number.is_finite()).ok_or_else(|| self.refuse("a number"))
    }
    pub(super) fn shown_path(&self) -> String {
        if self.path.is_empty() { "top level".to_owned() } else { self.path.clone() }
    }
    pub(super) fn refuse(&self, expected: &str) -> ModelError {
        self.refuse_as(shown(self.value), expected)
    }
    pub(super) fn refuse_key(&self, expected: &str) -> ModelError {
        self.refuse_as(format!("the unknown key `{}`", self.last_key()), expected)
    }
    pub(super) fn refuse_as(&self, found: String, expected: &str) -> ModelError {
        ModelError::Content {
            file: self.file.to_owned(),
            path: self.shown_path(),
            found,
            expected: expected.to_owned(),
        }
    }
}
