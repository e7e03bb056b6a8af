//! The tables of tuning: desired settings, revisions and outcomes, rollouts and trials.

use super::desired::NodeSetting;
use super::metric::{BeforeAfter, Figure, Figures, Mean};
use super::outcome::{Given, Outcome};
use super::revision::Revision;
use super::run::{BeforeAfterWindows, Measured, Run, Window};
use super::runs::RunKey;
use crate::store::row::{Cell, Columns, FromRow, IntoRow, Param, Row, read_all};
use crate::store::{Database, DatabaseKind, Store, StoreError, statements};

/// A rollout or trial is JSON in one column.
impl FromRow for Run {
    fn from_row(row: &mut Row) -> Result<Self, StoreError> {
        row.take_json()
    }
}

impl FromRow for RunKey {
    fn from_row(row: &mut Row) -> Result<Self, StoreError> {
        Ok(Self {
            kind: row.take()?,
            id: row.take()?,
        })
    }
}

/// The row of a rollout or trial.
struct RunRow<'a> {
    kind: &'a str,
    id: i64,
    ended_ms: Option<i64>,
    driver: &'a str,
    driven_until_ms: i64,
    state: String,
}

impl IntoRow for RunRow<'_> {
    const TABLE: &'static str = "runs";

    fn columns(&self) -> Result<Columns<'static>, StoreError> {
        Ok(vec![
            ("kind", self.kind.into()),
            ("id", self.id.into()),
            ("ended_ms", self.ended_ms.into()),
            ("driver", self.driver.into()),
            ("driven_until_ms", self.driven_until_ms.into()),
            ("state", self.state.as_str().into()),
        ])
    }
}

/// The row of a node's desired setting.
struct DesiredRow<'a>(&'a NodeSetting);

impl IntoRow for DesiredRow<'_> {
    const TABLE: &'static str = "desired";

    fn columns(&self) -> Result<Columns<'static>, StoreError> {
        let Self(desired) = self;
        Ok(vec![
            ("node", desired.node.as_str().into()),
            ("revision", desired.given.revision.cast_signed().into()),
            ("setting", Cell::json(&desired.setting)?),
        ])
    }
}

/// The row of a revision.
struct RevisionRow<'a> {
    number: u64,
    revision: &'a Revision,
}

impl IntoRow for RevisionRow<'_> {
    const TABLE: &'static str = "revisions";

    fn columns(&self) -> Result<Columns<'static>, StoreError> {
        let revision = self.revision;
        Ok(vec![
            ("revision", self.number.cast_signed().into()),
            ("at_ms", revision.at_ms.into()),
            ("who", revision.who.as_str().into()),
            ("why", revision.why.as_str().into()),
            ("origin", revision.origin.as_str().into()),
            ("selector", revision.selector.as_str().into()),
            ("setting", Cell::json(&revision.setting)?),
        ])
    }
}

impl FromRow for Revision {
    fn from_row(row: &mut Row) -> Result<Self, StoreError> {
        Ok(Self {
            number: Some(row.take()?),
            at_ms: row.take()?,
            who: row.take()?,
            why: row.take()?,
            origin: row.take()?,
            selector: row.take()?,
            setting: row.take_json()?,
            counts: row.take_json()?,
            nodes: Vec::new(),
        })
    }
}

/// The row of a node under a revision.
struct OutcomeRow<'a>(&'a NodeSetting);

impl IntoRow for OutcomeRow<'_> {
    const TABLE: &'static str = "revision_nodes";

    fn columns(&self) -> Result<Columns<'static>, StoreError> {
        let Self(desired) = self;
        let given = &desired.given;
        Ok(vec![
            ("revision", given.revision.cast_signed().into()),
            ("node", desired.node.as_str().into()),
            ("setting_before", Cell::json_or_null(desired.from.as_ref())?),
            ("given_ms", given.given_ms.into()),
            ("outcome", given.outcome.name().into()),
            ("at_ms", given.at_ms.into()),
            ("detail", given.detail.as_str().into()),
        ])
    }
}

impl FromRow for NodeSetting {
    fn from_row(row: &mut Row) -> Result<Self, StoreError> {
        // In the order of the statement's columns.
        let node = row.take()?;
        let revision = row.take()?;
        let setting = row.take_json()?;
        let from = row.take_json()?;
        let given_ms = row.take()?;
        let outcome = row.take_named(Outcome::named)?;
        let at_ms = row.take()?;
        let detail = row.take()?;
        Ok(Self {
            node,
            setting,
            from,
            given: Given {
                revision,
                given_ms,
                outcome,
                at_ms,
                detail,
            },
            set_back: 0,
            drifted_ms: None,
        })
    }
}

/// The figures over the clips of a node in a window.
struct ClipSums {
    node: String,
    /// Those that at least one clip has.
    figures: Figures,
}

impl FromRow for ClipSums {
    fn from_row(row: &mut Row) -> Result<Self, StoreError> {
        let node = row.take()?;
        let mut figures = Figures::new();
        // The statement has two columns for each figure: how many clips have it, and their sum.
        for figure in Figure::ALL {
            let clips: u64 = row.take()?;
            let sum: Option<f64> = row.take()?;
            if let Some(sum) = sum
                && clips > 0
            {
                figures.insert(figure, Mean { clips, sum });
            }
        }
        Ok(Self { node, figures })
    }
}

/// Deletes revisions before `day`, counted from the Unix epoch, at most 1000 rows of each table. Returns the largest
/// number of rows of one table.
pub(crate) fn delete_old(database: &mut dyn Database, day: i64) -> Result<usize, StoreError> {
    let mut most = 0;
    for statement in statements(include_str!("sql/delete_old.sql")) {
        let deleted = database.query(&statement, &[day.into()])?;
        most = most.max(deleted.len());
    }
    Ok(most)
}

impl dyn Database + '_ {
    /// Advances a counter by a statement with one parameter, and returns its new value.
    fn advance_counter(&mut self, statement: &str, parameter: Param) -> Result<i64, StoreError> {
        let value = self.number(statement, &[parameter])?;
        value.ok_or_else(|| StoreError::Statement("there is no such counter".to_owned()))
    }

    /// Stores a revision and its nodes, and makes its setting the desired one. Its number is higher than that of every
    /// earlier one of any hub, and than `above`. Returns the number, and the nodes with it.
    pub(crate) fn give(
        &mut self,
        revision: &Revision,
        mut nodes: Vec<NodeSetting>,
        above: u64,
    ) -> Result<(u64, Vec<NodeSetting>), StoreError> {
        let advanced = self.advance_counter(
            "UPDATE counters SET value = CASE WHEN value < $1 THEN $1 ELSE value END + 1 \
             WHERE name = 'revision' RETURNING value",
            above.cast_signed().into(),
        )?;
        let number = advanced.unsigned_abs();
        for node in &mut nodes {
            node.given.revision = number;
        }
        let desired: Vec<DesiredRow> = nodes.iter().map(DesiredRow).collect();
        self.insert(
            &desired,
            "ON CONFLICT (node) DO UPDATE SET revision = excluded.revision, \
             setting = excluded.setting WHERE excluded.revision > desired.revision",
        )?;
        self.insert(&[RevisionRow { number, revision }], "")?;
        self.outcomes(&nodes)?;
        self.query(
            "UPDATE revision_nodes SET outcome = 'superseded', at_ms = $1 \
             WHERE outcome IN ('pending', 'waiting', 'timed_out') AND revision < $2 \
             AND node IN (SELECT node FROM revision_nodes WHERE revision = $2)",
            &[revision.at_ms.into(), number.cast_signed().into()],
        )?;
        Ok((number, nodes))
    }

    /// Stores outcomes. One that has ended since then, for example because its node was forgotten, stays as it is.
    pub(crate) fn outcomes(&mut self, nodes: &[NodeSetting]) -> Result<(), StoreError> {
        let rows: Vec<OutcomeRow> = nodes.iter().map(OutcomeRow).collect();
        let conflict = "ON CONFLICT (revision, node) DO UPDATE SET outcome = excluded.outcome, \
                        at_ms = excluded.at_ms, detail = excluded.detail \
                        WHERE revision_nodes.outcome IN ('pending', 'waiting', 'timed_out')";
        self.insert(&rows, conflict)?;
        Ok(())
    }

    /// Drops the desired setting of a node, and ends the revisions that it has not answered.
    pub(crate) fn drop_desired(&mut self, node: &str, now_ms: i64) -> Result<(), StoreError> {
        self.query(
            "UPDATE revision_nodes SET outcome = 'missed', at_ms = $2, detail = 'the node was forgotten' \
             WHERE node = $1 AND outcome IN ('pending', 'waiting', 'timed_out')",
            &[node.into(), now_ms.into()],
        )?;
        self.query("DELETE FROM desired WHERE node = $1", &[node.into()])?;
        Ok(())
    }

    /// Stores a rollout or trial, and renews the claim of `driver`. A new one gets its number. Returns the number, or
    /// stores nothing and returns `None` if another hub has taken the claim.
    pub(crate) fn save_run(
        &mut self,
        mut run: Run,
        driver: &str,
        until_ms: i64,
    ) -> Result<Option<i64>, StoreError> {
        let kind = run.kind.name();
        if run.id == 0 {
            let text = "UPDATE counters SET value = value + 1 WHERE name = $1 RETURNING value";
            run.id = self.advance_counter(text, kind.into())?;
        }
        let row = RunRow {
            kind,
            id: run.id,
            ended_ms: run.ended_ms,
            driver,
            driven_until_ms: until_ms,
            state: serde_json::to_string(&run)?,
        };
        let conflict = "ON CONFLICT (kind, id) DO UPDATE SET ended_ms = excluded.ended_ms, state = excluded.state, \
                        driven_until_ms = excluded.driven_until_ms WHERE runs.driver = excluded.driver RETURNING id";
        let stored = self.insert(&[row], conflict)?;
        if stored.is_empty() {
            return Ok(None);
        }
        Ok(Some(run.id))
    }

    /// Claims a rollout or trial that has ended, so that `driver` can return its values. Returns false if it has not
    /// ended.
    pub(crate) fn claim_ended_run(
        &mut self,
        key: &RunKey,
        driver: &str,
    ) -> Result<bool, StoreError> {
        let claimed = self.query(
            "UPDATE runs SET driver = $1 WHERE kind = $2 AND id = $3 AND ended_ms IS NOT NULL RETURNING id",
            &[driver.into(), key.kind.as_str().into(), key.id.into()],
        )?;
        Ok(!claimed.is_empty())
    }

    /// Claims the rollouts and trials whose claims ended before `now_ms`, and renews the claims of `driver`. An SQLite file has
    /// only one hub, which claims all.
    pub(crate) fn claim_runs(
        &mut self,
        driver: &str,
        now_ms: i64,
        until_ms: i64,
    ) -> Result<Vec<RunKey>, StoreError> {
        let free_ms = match self.kind() {
            DatabaseKind::Sqlite => i64::MAX,
            DatabaseKind::Postgres => now_ms,
        };
        let rows = self.query(
            "UPDATE runs SET driver = $1, driven_until_ms = $2 WHERE ended_ms IS NULL \
             AND (driver = $1 OR driven_until_ms < $3) RETURNING kind, id",
            &[driver.into(), until_ms.into(), free_ms.into()],
        )?;
        read_all(rows)
    }
}

impl Store {
    /// Desired settings with revisions above `after`. The outcome of a very old one is no longer stored.
    pub(crate) async fn desired_after(&self, after: u64) -> Result<Vec<NodeSetting>, StoreError> {
        let text = "SELECT d.node, d.revision, d.setting, n.setting_before, \
                    coalesce(n.given_ms, 0), coalesce(n.outcome, 'untouched'), \
                    coalesce(n.at_ms, 0), coalesce(n.detail, '') \
                    FROM desired d LEFT JOIN revision_nodes n \
                    ON n.revision = d.revision AND n.node = d.node WHERE d.revision > $1";
        read_all(self.query(text, vec![after.cast_signed().into()]).await?)
    }

    /// The outcome of a revision at each node.
    pub(crate) async fn revision_nodes(
        &self,
        revision: u64,
    ) -> Result<Vec<NodeSetting>, StoreError> {
        let text = "SELECT n.node, n.revision, r.setting, n.setting_before, \
                    n.given_ms, n.outcome, n.at_ms, n.detail \
                    FROM revision_nodes n JOIN revisions r ON r.revision = n.revision \
                    WHERE n.revision = $1 ORDER BY n.node";
        read_all(self.query(text, vec![revision.cast_signed().into()]).await?)
    }

    /// The newest revisions below the number `before`; only those of `node`, if it is given.
    pub(crate) async fn revisions(
        &self,
        before: i64,
        node: Option<&str>,
        limit: i64,
    ) -> Result<Vec<Revision>, StoreError> {
        let object = match self.database_kind() {
            DatabaseKind::Sqlite => "json_group_object",
            DatabaseKind::Postgres => "jsonb_object_agg",
        };
        let text = format!(
            "SELECT r.revision, r.at_ms, r.who, r.why, r.origin, r.selector, r.setting, \
             (SELECT coalesce(CAST({object}(c.outcome, c.nodes) AS TEXT), '{{}}') FROM (SELECT outcome, \
             count(*) AS nodes FROM revision_nodes WHERE revision = r.revision GROUP BY outcome) AS c) AS counts \
             FROM revisions r WHERE r.revision < $1 \
             AND ($2 = '' OR r.revision IN (SELECT revision FROM revision_nodes WHERE node = $2)) \
             ORDER BY r.revision DESC LIMIT $3"
        );
        let values = vec![before.into(), node.unwrap_or_default().into(), limit.into()];
        read_all(self.query(text, values).await?)
    }

    /// The newest rollouts or trials with numbers below `before`.
    pub(crate) async fn runs(
        &self,
        kind: &str,
        before: i64,
        limit: i64,
    ) -> Result<Vec<Run>, StoreError> {
        let text = "SELECT state FROM runs WHERE kind = $1 AND id < $2 ORDER BY id DESC LIMIT $3";
        let values = vec![kind.into(), before.into(), limit.into()];
        read_all(self.query(text, values).await?)
    }

    /// The rollouts and trials that have not ended, of all hubs.
    pub(crate) async fn open_runs(&self) -> Result<Vec<Run>, StoreError> {
        let text = "SELECT state FROM runs WHERE ended_ms IS NULL";
        read_all(self.query(text, Vec::new()).await?)
    }

    /// One rollout or trial.
    pub(crate) async fn run(&self, kind: &str, id: i64) -> Result<Option<Run>, StoreError> {
        let found = self.runs(kind, id.saturating_add(1), 1).await?;
        Ok(found.into_iter().find(|run| run.id == id))
    }

    /// Measures the clips of each node in its two windows.
    pub(crate) async fn measure(
        &self,
        windows: &[BeforeAfterWindows],
    ) -> Result<Measured, StoreError> {
        let mut found = Measured::new();
        for one in windows {
            found.insert(one.before.node.clone(), BeforeAfter::default());
        }
        // In chunks, so that a connection for reading is not held for long.
        for chunk in windows.chunks(500) {
            let before = chunk.iter().map(|one| &one.before).collect();
            for sums in self.clip_sums(before).await? {
                if let Some(node) = found.get_mut(&sums.node) {
                    node.before = sums.figures;
                }
            }
            let after = chunk.iter().map(|one| &one.after).collect();
            for sums in self.clip_sums(after).await? {
                if let Some(node) = found.get_mut(&sums.node) {
                    node.after = sums.figures;
                }
            }
        }
        Ok(found)
    }

    /// Sums the clips in these windows, of which each node has at most one.
    async fn clip_sums(&self, windows: Vec<&Window>) -> Result<Vec<ClipSums>, StoreError> {
        let rows = match self.database_kind() {
            DatabaseKind::Sqlite => "json_each($1)",
            DatabaseKind::Postgres => "jsonb_array_elements($1::jsonb)",
        };
        let text = format!(
            "WITH w AS (SELECT value ->> 'node' AS node, value ->> 'threshold' AS threshold, value ->> 'value' AS value, \
             CAST(value ->> 'from_ms' AS BIGINT) AS from_ms, CAST(value ->> 'until_ms' AS BIGINT) AS until_ms \
             FROM {rows})\n{}",
            include_str!("sql/clip_sums.sql")
        );
        let values = vec![serde_json::to_string(&windows)?.into()];
        read_all(self.query(text, values).await?)
    }
}

#[cfg(test)]
mod tests {
    use super::super::desired::NodeSetting;
    use super::super::outcome::Outcome;
    use super::OutcomeRow;
    use crate::store::row::{Cell, FromRow as _, IntoRow as _, Row};
    use albireo_wire::{DesiredSetting, Target, Threshold};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_setting_reads_back_as_the_same(value in prop::num::f64::NORMAL, which in 0..Target::NAMES.len()) {
            let target = Target::named(Target::NAMES[which], value);
            for from in [
                Some(DesiredSetting::Threshold(Threshold::new("u", value))),
                Some(DesiredSetting::Target(target)),
                Some(DesiredSetting::Target(None)),
                None,
            ] {
                let setting = from.unwrap_or(DesiredSetting::Target(None));
                let given = NodeSetting::new("a".to_owned(), setting, from, Outcome::Applied, 1);
                // As a message.
                let message = serde_json::to_string(&given).unwrap();
                prop_assert_eq!(&serde_json::from_str::<NodeSetting>(&message).unwrap(), &given);
                // As a row that is read: the node comes first, and the setting is that of the revision.
                let mut row: Vec<Cell> = OutcomeRow(&given)
                    .columns()
                    .unwrap()
                    .into_iter()
                    .map(|(_, cell)| cell)
                    .collect();
                row.swap(0, 1);
                row.insert(2, Cell::json(&setting).unwrap());
                prop_assert_eq!(NodeSetting::from_row(&mut Row::new(row)).unwrap(), given);
            }
        }
    }
}
