-- What somebody wrote about a capture ("on foam, 23 °C"), one line; NULL: nothing.
ALTER TABLE capture ADD COLUMN note TEXT CHECK (note <> '');
