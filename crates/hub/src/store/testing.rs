//! Databases for tests: SQLite in a temporary folder, and PostgreSQL's own server on a socket in one.
