/** The part of Plotly that the pages use, and a figure as the server sends it. */

type Cell = number | string | null;

/** Values as JSON, or as Plotly's encoded array. */
type Column = Cell[] | { bdata: string; dtype: string };

/** How a curve of a running run grows: which column of its history it shows, and how that becomes its y. */
interface Follow {
  column: "parameters" | "sigma" | "tail_rms_rad" | "aggregate_rms_rad" | "nis_per_dof";
  index?: number;
  origin?: number;
  factor: number;
  band?: number;
  share?: number;
  level?: boolean;
}

interface Trace {
  x?: Column;
  y?: Column;
  z?: Column;
  customdata?: Column;
  xaxis?: string;
  fillcolor?: string;
  hovertemplate?: string;
  hovertext?: string[];
  line?: object;
  meta?: { follow?: Follow; sigmas?: number };
}

/** A trace as it is drawn, its arrays decoded. */
interface DrawnTrace extends Omit<Trace, "x" | "y" | "customdata"> {
  x: ArrayLike<number> & Iterable<number>;
  y: ArrayLike<number> & Iterable<number>;
  customdata?: ArrayLike<number> & Iterable<number>;
}

interface Axis {
  range?: [number, number];
  autorange?: boolean;
  matches?: string;
  type?: string;
  title?: { text?: string };
}

type AxisName = `xaxis${string}` | `yaxis${string}`;

/** As of which step of a running run a figure is: of how many, and when that was heard of. */
interface Place {
  axis: string;
  step: number;
  of?: number | null;
  at_utc?: string | null;
}

/** What the server says of a figure: the templates of the other themes, and what the page can do with it. */
interface FigureMeta {
  light?: object;
  contrast?: object;
  axis?: string;
  detail?: boolean;
  as_of?: Place;
  log?: AxisName[];
}

interface Layout {
  title?: { text?: string };
  template?: object;
  legend?: { y?: number };
  margin?: { t?: number };
  height?: number;
  width?: number;
  autosize?: boolean;
  paper_bgcolor?: string;
  plot_bgcolor?: string;
  annotations?: { text?: string }[];
  meta?: FigureMeta;
  [axis: AxisName]: Axis | undefined;
}

interface Figure {
  data: Trace[];
  layout: Layout;
}

/** What a person changed of the axes: `xaxis.range[0]`, `xaxis.range[1]`, `xaxis.autorange`; ends of a time axis are dates. */
type ZoomChange = Record<string, number | string | boolean | number[] | undefined>;

/** The element that a figure is drawn in; it has more once it is drawn. */
interface Canvas extends HTMLDivElement {
  data?: Trace[];
  layout?: Layout;
  on?(name: "plotly_relayout" | "plotly_beforehover", hear: (change: ZoomChange) => void): void;
  on?(name: "plotly_doubleclick", hear: () => void): void;
}

interface PlotlyLibrary {
  react(canvas: Canvas, data: Trace[], layout: Layout, config: Record<string, boolean>): Promise<Canvas>;
  update(canvas: Canvas, traces: Record<string, unknown[]>, layout: Record<string, unknown>, which: number[]): Promise<Canvas>;
  relayout(canvas: Canvas, changes: Layout | Record<string, unknown>): Promise<Canvas>;
  purge(canvas: Canvas): void;
  toImage(figure: Figure, options: { format: "png"; width: number; height: number; scale: number }): Promise<string>;
}

interface Window {
  Plotly?: PlotlyLibrary;
}
