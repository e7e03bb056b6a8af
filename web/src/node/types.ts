// The messages of a node, from its OpenAPI document.

import type { components } from "../api/node";

type Schemas = components["schemas"];

export type AuditFigures = Schemas["AuditFigures"];
export type AuditRate = Schemas["AuditRate"];
export type Target = Schemas["Target"];
export type TargetReport = Schemas["TargetReport"];
export type CameraEntry = Schemas["CameraEntry"];
export type ClipReport = Schemas["ClipReport"];
export type Counters = Schemas["CountersMessage"];
export type DetectorEvent = Schemas["DetectorEvent"];
export type Detections = Schemas["DetectionsMessage"];
export type Frame = Schemas["FrameEvent"];
export type FrameState = Schemas["FrameState"];
export type BoxSource = Schemas["BoxSource"];
export type CallCause = Schemas["CallCause"];
export type CameraHistory = Schemas["CameraHistory"];
export type CameraSlot = Schemas["CameraSlot"];
export type PowerHistory = Schemas["PowerHistory"];
export type SkipEstimates = Schemas["SkipEstimates"];
export type LogLine = Schemas["LogLine"];
export type Savings = Schemas["Savings"];
export type Overview = Schemas["NodeOverview"];
export type States = Schemas["NodeStates"];
export type PolicyInForce = Schemas["PolicyInForce"];
export type Pause = Schemas["Pause"];
export type Threshold = Schemas["ThresholdEvent"];
export type Thresholds = Schemas["Thresholds"];
export type CameraThreshold = Schemas["CameraThreshold"];
export type ThresholdSpec = Schemas["ThresholdSpec"];
