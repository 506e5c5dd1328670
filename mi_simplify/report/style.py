"""
The style sheet of the report: system fonts, light or dark as the reader's system is.
"""

CSS = """
:root {
  color-scheme: light dark;
  --paper: #fbfbfa; --card: #ffffff; --ink: #1b1c1f; --soft: #62656d; --line: #e3e4e7;
  --accent: #2f5fd0; --good: #17784a; --bad: #b3382c;
}
@media (prefers-color-scheme: dark) {
  :root {
    --paper: #141517; --card: #1c1d20; --ink: #ececf0; --soft: #9a9da6; --line: #2f3136;
    --accent: #86a8ff; --good: #63c998; --bad: #f08a7e;
  }
}
* { box-sizing: border-box; }
body {
  margin: 0; background: var(--paper); color: var(--ink);
  font: 16px/1.55 system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif;
  -webkit-text-size-adjust: 100%;
}
main { max-width: 1240px; margin: 0 auto; padding: 48px 28px 80px; }
header { margin-bottom: 28px; }
.kind { margin: 0 0 4px; color: var(--soft); font-size: 13px; letter-spacing: .06em; text-transform: uppercase; }
h1 { margin: 0; font-size: 34px; line-height: 1.15; font-weight: 650; letter-spacing: -.015em; }
h1, td { overflow-wrap: anywhere; }
.lead { margin: 8px 0 0; color: var(--soft); max-width: 68ch; }
h2 { margin: 52px 0 14px; font-size: 20px; font-weight: 650; letter-spacing: -.005em; }
h2 + .hint { margin-top: -10px; }
.hint { margin: 0 0 14px; color: var(--soft); font-size: 14px; max-width: 78ch; }
.key { display: inline-block; width: .75em; height: .75em; border-radius: 2px; margin: 0 .1em 0 .35em; }

.cards { display: grid; grid-template-columns: repeat(auto-fit, minmax(190px, 1fr)); gap: 14px; margin: 0; padding: 0; }
.card { background: var(--card); border: 1px solid var(--line); border-radius: 10px; padding: 16px 18px; }
.card .name { color: var(--soft); font-size: 13px; }
.card .value { font-size: 28px; font-weight: 650; letter-spacing: -.02em; line-height: 1.3; }
.card .value small { font-size: 15px; font-weight: 500; color: var(--soft); letter-spacing: 0; }
.card .change { font-size: 13px; color: var(--soft); }
.card, figcaption { font-variant-numeric: tabular-nums; }
.good { color: var(--good); } .bad { color: var(--bad); }

.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-size: 14.5px; font-variant-numeric: tabular-nums; min-width: 46%; }
th, td { text-align: right; padding: 7px 0 7px 28px; border-bottom: 1px solid var(--line); white-space: nowrap; }
th:first-child, td:first-child { text-align: left; padding-left: 0; }
thead th { color: var(--soft); font-weight: 500; }
tbody th { font-weight: 500; }

.views { display: grid; gap: 10px 8px; min-width: max(100%, calc(var(--columns) * 130px)); }
.views { grid-template-columns: 1.6em repeat(var(--columns), minmax(0, 1fr)); align-items: start; }
.views .head { overflow-wrap: anywhere; color: var(--soft); font-size: 13.5px; padding-bottom: 2px; }
.views .row { color: var(--soft); font-size: 13.5px; align-self: center; }
figure { margin: 0; }
figure img { display: block; width: 100%; height: auto; border-radius: 6px; background: #000; }
figcaption { color: var(--soft); font-size: 12.5px; padding-top: 3px; min-height: 1.9em; }
.views figcaption { text-align: right; }

.charts { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(440px, 100%), 1fr)); gap: 14px; }
.chart { background: var(--card); border: 1px solid var(--line); border-radius: 10px; padding: 14px 16px 10px; }
.chart h3 { margin: 0 0 6px; font-size: 14px; font-weight: 600; }
svg.curve { display: block; width: 100%; height: auto; }
svg .grid { stroke: var(--line); } svg .axis { stroke: var(--soft); }
svg .line { fill: none; stroke: var(--accent); stroke-width: 2; stroke-linejoin: round; stroke-linecap: round; }
svg .end { fill: var(--accent); }
svg .tick, svg .label { fill: var(--soft); font-size: 12px; font-variant-numeric: tabular-nums; }

.textures { display: grid; grid-template-columns: repeat(auto-fill, minmax(200px, 1fr)); gap: 16px; }
.textures img { border: 1px solid var(--line); image-rendering: auto; }
.checker img {
  background: repeating-conic-gradient(#8a8a8a 0 25%, #b0b0b0 0 50%) 0 0 / 16px 16px;
}
pre {
  margin: 0; padding: 16px 18px; background: var(--card); border: 1px solid var(--line); border-radius: 10px;
  font: 13px/1.6 ui-monospace, "SF Mono", Menlo, Consolas, monospace; overflow-x: auto; tab-size: 2;
}
ul.notes { margin: 0; padding-left: 1.2em; }
details summary { cursor: pointer; color: var(--soft); font-size: 14px; margin-bottom: 12px; }
footer { margin-top: 64px; padding-top: 14px; border-top: 1px solid var(--line); color: var(--soft); font-size: 13px; }
@media (max-width: 640px) { main { padding: 28px 16px 56px; } h1 { font-size: 27px; } h2 { margin-top: 40px; } }
@media print { body { background: #fff; } .card, .chart, pre { break-inside: avoid; } }
"""
