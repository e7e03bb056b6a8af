// The messages of a hub, from its OpenAPI document.

import type { components } from "../api/hub";

type Schemas = components["schemas"];

export type HubReadiness = Schemas["HubReadiness"];
export type NodeList = Schemas["NodeList"];
export type NodeView = Schemas["NodeView"];
export type NodeDetail = Schemas["NodeDetail"];
export type CountersMessage = Schemas["CountersMessage"];
export type PresenceState = Schemas["PresenceState"];
export type Energy = Schemas["Energy"];
export type EnergyGroup = Schemas["EnergyGroup"];
export type StoredClip = Schemas["StoredClip"];
export type StoredEvent = Schemas["StoredEvent"];
export type NodeSetting = Schemas["NodeSetting"];
export type TargetStatus = Schemas["TargetStatus"];
export type DesiredSetting = Schemas["DesiredSetting"];
export type Threshold = Schemas["Threshold"];
export type TargetReport = Schemas["TargetReport"];
export type Drift = Schemas["Drift"];
export type Revision = Schemas["Revision"];
export type RolloutView = Extract<Schemas["Run"], { kind: "rollout" }>;
export type GateResult = Schemas["GateResult"];
export type Interval = Schemas["Interval"];
export type TrialView = Extract<Schemas["Run"], { kind: "trial" }>;
export type ArmFigure = Schemas["ArmFigure"];
export type SetAside = Schemas["StoredSetAside"];
