//! The tables of tuning: desired settings, revisions and outcomes, rollouts and trials.

use super::desired::NodeSetting;
use super::metric::{BeforeAfter, Figure, Figures, Mean};
use super::outcome::Outcome;
use super::revision::Revision;
use super::run::{Measured, Run, Window};
use super::runs::RunKey;
use crate::store::row::{Row, json_text, read_all};
use crate::store::{Database, DatabaseKind, Store, StoreError};
use albireo_wire::DesiredSetting;
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// A rollout or trial, which is JSON in one column.
#[derive(Deserialize)]
struct RunState {
    #[serde(deserialize_with = "json_text::deserialize")]
    state: Run,
}

/// Reads rollouts and trials.
fn runs(rows: Vec<Row>) -> Result<Vec<Run>, StoreError> {
    let runs: Vec<RunState> = read_all(rows)?;
    Ok(runs.into_iter().map(|run| run.state).collect())
}

/// The row of a rollout or trial.
#[derive(Serialize)]
struct RunRow<'a> {
    kind: &'a str,
    id: i64,
    ended_ms: Option<i64>,
    driver: &'a str,
    driven_until_ms: i64,
    state: String,
}

/// The row of a node's desired setting.
#[derive(Serialize)]
struct DesiredRow<'a> {
    node: &'a str,
    revision: u64,
    setting: DesiredSetting,
}

/// The row of a revision.
#[derive(Serialize)]
struct RevisionRow<'a> {
    revision: u64,
    at_ms: i64,
    who: &'a str,
    why: &'a str,
    origin: &'a str,
    selector: &'a str,
    setting: DesiredSetting,
}

/// The row of a node under a revision.
#[derive(Serialize)]
struct OutcomeRow<'a> {
    revision: u64,
    node: &'a str,
    setting_before: Option<DesiredSetting>,
    given_ms: i64,
    outcome: Outcome,
    at_ms: i64,
    detail: &'a str,
}

impl<'a> OutcomeRow<'a> {
    fn of(desired: &'a NodeSetting) -> Self {
        let given = &desired.given;
        Self {
            revision: given.revision,
            node: &desired.node,
            setting_before: desired.from,
            given_ms: given.given_ms,
            outcome: given.outcome,
            at_ms: given.at_ms,
            detail: &given.detail,
        }
    }
}

/// The clips of a node in a window: for each figure how many clips have it, and their sum.
#[derive(Deserialize)]
struct SumsRow {
    node: String,
    clips_skip_rate: u64,
    sum_skip_rate: Option<f64>,
    clips_joules_measured: u64,
    sum_joules_measured: Option<f64>,
    clips_joules_estimated: u64,
    sum_joules_estimated: Option<f64>,
    clips_edp_measured: u64,
    sum_edp_measured: Option<f64>,
    clips_edp_estimated: u64,
    sum_edp_estimated: Option<f64>,
    clips_latency_p99: u64,
    sum_latency_p99: Option<f64>,
    clips_degraded: u64,
    sum_degraded: Option<f64>,
    clips_recall: u64,
    sum_recall: Option<f64>,
    clips_precision: u64,
    sum_precision: Option<f64>,
}

impl SumsRow {
    /// The figures that at least one clip has.
    fn figures(&self) -> Figures {
        let figures = Figure::ALL.into_iter().filter_map(|figure| {
            let (clips, sum) = match figure {
                Figure::SkipRate => (self.clips_skip_rate, self.sum_skip_rate),
                Figure::JoulesMeasured => (self.clips_joules_measured, self.sum_joules_measured),
                Figure::JoulesEstimated => (self.clips_joules_estimated, self.sum_joules_estimated),
                Figure::EdpMeasured => (self.clips_edp_measured, self.sum_edp_measured),
                Figure::EdpEstimated => (self.clips_edp_estimated, self.sum_edp_estimated),
                Figure::LatencyP99 => (self.clips_latency_p99, self.sum_latency_p99),
                Figure::Degraded => (self.clips_degraded, self.sum_degraded),
                Figure::Recall => (self.clips_recall, self.sum_recall),
                Figure::Precision => (self.clips_precision, self.sum_precision),
            };
            Some((
                figure,
                Mean {
                    clips,
                    sum: sum.filter(|_| clips > 0)?,
                },
            ))
        });
        figures.collect()
    }
}

/// Deletes revisions before `day`, at most 1000 rows of each table. Returns the largest number of rows of one table.
pub(crate) fn delete_old(database: &mut dyn Database, day: i64) -> Result<usize, StoreError> {
    let mut most = 0;
    for text in include_str!("sql/delete_old.sql").split(';') {
        most = most.max(database.query(text, &[day.into()])?.len());
    }
    Ok(most)
}

impl dyn Database + '_ {
    fn next(&mut self, statement: &str, with: Value) -> Result<i64, StoreError> {
        let value = self.number(statement, &[with])?;
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
        let number = self.next(
            "UPDATE counters SET value = CASE WHEN value < $1 THEN $1 ELSE value END + 1 \
             WHERE name = 'revision' RETURNING value",
            above.into(),
        )?;
        let number = number.unsigned_abs();
        for node in &mut nodes {
            node.given.revision = number;
        }
        let desired = nodes.iter().map(|node| DesiredRow {
            node: &node.node,
            revision: number,
            setting: node.setting,
        });
        self.insert(
            "desired",
            &desired.collect::<Vec<_>>(),
            "ON CONFLICT (node) DO UPDATE SET revision = excluded.revision, \
             setting = excluded.setting WHERE excluded.revision > desired.revision",
        )?;
        let row = RevisionRow {
            revision: number,
            at_ms: revision.at_ms,
            who: &revision.who,
            why: &revision.why,
            origin: &revision.origin,
            selector: &revision.selector,
            setting: revision.setting,
        };
        self.insert("revisions", &[row], "")?;
        self.outcomes(&nodes)?;
        self.query(
            "UPDATE revision_nodes SET outcome = 'superseded', at_ms = $1 \
             WHERE outcome IN ('pending', 'waiting', 'timed_out') AND revision < $2 \
             AND node IN (SELECT node FROM revision_nodes WHERE revision = $2)",
            &[revision.at_ms.into(), number.into()],
        )?;
        Ok((number, nodes))
    }

    /// Stores outcomes. One that has ended since then, for example because its node was forgotten, stays as it is.
    pub(crate) fn outcomes(&mut self, nodes: &[NodeSetting]) -> Result<(), StoreError> {
        let row = |node| OutcomeRow::of(node);
        let rows: Vec<OutcomeRow> = nodes.iter().map(row).collect();
        let conflict = "ON CONFLICT (revision, node) DO UPDATE SET outcome = excluded.outcome, \
                        at_ms = excluded.at_ms, detail = excluded.detail \
                        WHERE revision_nodes.outcome IN ('pending', 'waiting', 'timed_out')";
        self.insert("revision_nodes", &rows, conflict).map(drop)
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

    /// Stores a rollout or trial, and renews the claim of `driver`, unless another hub drives it; nobody drives one that has
    /// ended. A new one gets its number, which is returned.
    pub(crate) fn save_run(
        &mut self,
        mut run: Run,
        driver: &str,
        until_ms: i64,
    ) -> Result<i64, StoreError> {
        let kind = run.kind.name();
        if run.id == 0 {
            let text = "UPDATE counters SET value = value + 1 WHERE name = $1 RETURNING value";
            run.id = self.next(text, kind.into())?;
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
                        driver = excluded.driver, driven_until_ms = excluded.driven_until_ms \
                        WHERE runs.driver = excluded.driver OR runs.ended_ms IS NOT NULL";
        self.insert("runs", &[row], conflict)?;
        Ok(run.id)
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
        let text = "SELECT d.node, d.revision, d.setting AS \"to\", n.setting_before AS \"from\", \
                    coalesce(n.outcome, 'untouched') AS outcome, coalesce(n.given_ms, 0) AS given_ms, \
                    coalesce(n.at_ms, 0) AS at_ms, coalesce(n.detail, '') AS detail \
                    FROM desired d LEFT JOIN revision_nodes n \
                    ON n.revision = d.revision AND n.node = d.node WHERE d.revision > $1";
        read_all(self.query(text, vec![after.into()]).await?)
    }

    /// The outcome of a revision at each node.
    pub(crate) async fn revision_nodes(
        &self,
        revision: u64,
    ) -> Result<Vec<NodeSetting>, StoreError> {
        let text = "SELECT n.node, n.revision, r.setting AS \"to\", n.setting_before AS \"from\", n.outcome, \
                    n.given_ms, n.at_ms, n.detail \
                    FROM revision_nodes n JOIN revisions r ON r.revision = n.revision \
                    WHERE n.revision = $1 ORDER BY n.node";
        read_all(self.query(text, vec![revision.into()]).await?)
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
            "SELECT r.revision, r.at_ms, r.who, r.why, r.origin, r.selector AS \"select\", r.setting AS \"to\", \
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
        runs(self.query(text, values).await?)
    }

    /// The rollouts and trials that have not ended, of all hubs.
    pub(crate) async fn open_runs(&self) -> Result<Vec<Run>, StoreError> {
        let text = "SELECT state FROM runs WHERE ended_ms IS NULL";
        runs(self.query(text, Vec::new()).await?)
    }

    /// One rollout or trial.
    pub(crate) async fn run(&self, kind: &str, id: i64) -> Result<Option<Run>, StoreError> {
        let found = self.runs(kind, id.saturating_add(1), 1).await?;
        Ok(found.into_iter().find(|run| run.id == id))
    }

    /// Measures the clips of each node in its two windows.
    pub(crate) async fn measure(&self, windows: &[[Window; 2]]) -> Result<Measured, StoreError> {
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
        let nodes = windows.iter().map(|[before, _]| before.node.clone());
        let mut found: Measured = nodes.map(|node| (node, BeforeAfter::default())).collect();
        for side in [0, 1] {
            // In chunks, so that a connection for reading is not held for long.
            for windows in windows.chunks(500) {
                let windows: Vec<_> = windows.iter().map(|both| &both[side]).collect();
                let values = vec![serde_json::to_string(&windows)?.into()];
                let rows: Vec<SumsRow> = read_all(self.query(text.clone(), values).await?)?;
                for row in rows {
                    let Some(clips) = found.get_mut(&row.node) else {
                        continue;
                    };
                    match side {
                        0 => clips.before = row.figures(),
                        _ => clips.after = row.figures(),
                    }
                }
            }
        }
        Ok(found)
    }
}

#[cfg(test)]
mod tests {
    use super::super::desired::NodeSetting;
    use super::super::outcome::{Given, Outcome};
    use crate::store::row::{read, row};
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
                let mut written = row(&given).unwrap();
                prop_assert_eq!(&read::<NodeSetting>(written.clone()).unwrap(), &given);
                // In a table it is text.
                for column in ["from", "to"] {
                    if written[column].is_object() {
                        written[column] = written[column].to_string().into();
                    }
                }
                prop_assert_eq!(read::<NodeSetting>(written).unwrap(), given);
            }
        }
    }

    #[test]
    fn a_column_of_another_type_or_a_missing_one_is_a_clear_error() {
        let mut row = row(&serde_json::json!({ "revision": "seven" })).unwrap();
        let error = read::<Given>(row.clone()).unwrap_err();
        assert!(error.to_string().contains("seven"), "{error}");
        row.clear();
        let error = read::<Given>(row).unwrap_err();
        assert!(error.to_string().contains("revision"), "{error}");
    }
}
