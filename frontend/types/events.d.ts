/** The events of the server's feed, as link-state.js passes them on, and those that the pages' own modules send. */

type RunState = "QUEUED" | "RUNNING" | "CANCELLING" | "SUCCEEDED" | "FAILED" | "CANCELLED" | "LOST";

/** New points of a running run, column by column; `after` is the frame before the first, null at the beginning. */
interface HistoryPoints {
  after: number | null;
  frame: number[];
  parameters?: (number[] | null)[];
  sigma?: ((number | null)[] | null)[];
  tail_rms_rad?: (number | null)[];
  aggregate_rms_rad?: (number | null)[];
  nis_per_dof?: (number | null)[];
}

interface RunEvent {
  run_id: number;
  attempt: number;
  at_utc: string;
  state: RunState;
  message: string;
}

interface LogEvent {
  run_id: number;
  attempt: number;
  at_utc: string;
  kind: string;
  message: string;
  state?: undefined;
}

interface RunProgress {
  run_id: number;
  attempt: number;
  fraction: number;
  elapsed_s: number;
  message: string;
  history?: HistoryPoints;
  state?: undefined;
}

interface AuditEvent {
  id: number;
  at_utc: string;
  actor: string;
  action: string;
  object: string;
}

/** Some events were lost: everything is to be read again. */
interface MissedEvent {
  id?: string;
  run_id?: undefined;
  state?: undefined;
}

/** Whether the page can be believed; `sinceMs` is when the server was last heard. */
interface LinkState {
  state: "live" | "stale" | "disconnected" | "logged-out";
  sinceMs: number;
}

interface FeedEvents {
  run: RunEvent;
  log: LogEvent;
  progress: RunProgress;
  audit: AuditEvent;
  missed: MissedEvent;
}

type FeedEventMap = { [Kind in keyof FeedEvents as `boresight:${Kind}`]: CustomEvent<FeedEvents[Kind]> };

interface DocumentEventMap extends FeedEventMap {
  "boresight:theme": CustomEvent<string>;
  "boresight:link": CustomEvent<LinkState>;
  "boresight:doubt": CustomEvent<null>;
  "boresight:renewed": CustomEvent<null>;
  "figure-drawn": CustomEvent<null>;
}

interface HTMLElementEventMap {
  "figure-refresh": CustomEvent<null>;
}
