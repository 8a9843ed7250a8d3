// The drops of a `watch`, or the impacts of a dataset.
const $ = (id) => document.getElementById(id);
const drops = new Map();
const MOST_LINES = 200;
const { element } = bench;
let chosen = null, following = true, wanted = null, nouns = {};

const short = (value) => (value === null || value === undefined ? "–" : Number(value.toPrecision(4)).toString());
// The ends have the median's decimals, and stay on one line.
const interval = (n) => {
  if (!n || !n.length) return "–";
  if (!n[0]) return `${short(n[0])} (${short(n[1])} to ${short(n[2])})`;
  const decimals = Math.min(Math.max(3 - Math.floor(Math.log10(Math.abs(n[0]))), 0), 8);
  const [middle, low, high] = n.map((value) => (value === null || value === undefined ? "–" : value.toFixed(decimals)));
  return `${middle} (${low}\u00a0to\u00a0${high})`;
};
const percent = (share) => `${(100 * share).toFixed(1)} %`;
const facts = (cells) => Object.entries(cells).map(([name, value]) => `${name} ${value}`).join(", ");

async function act(action, content, said) {
  const refused = await bench.act(action, content);
  if (said) said.textContent = refused || "done";
  await refresh();
}

function show(state) {
  wanted = state.wanted;
  nouns = state.nouns;
  document.title = state.name;
  $("name").textContent = state.name;
  $("where").textContent = state.watching ? `${state.watching} → ${state.dataset}, ${state.used} drops in use` : `${state.dataset}, ${state.used} impacts in use`;
  for (const line of state.lines) $("log").prepend(element("li", line));
  while ($("log").children.length > MOST_LINES) $("log").lastChild.remove();
  $("now").hidden = !state.watching;
  $("back-words").textContent = state.back;
  $("order").textContent = state.watching ? "Newest first." : "";
  $("progress").textContent = state.planned ? `${state.left} drops left${state.left ? `; next: ${facts(state.next)}` : ""}` : "";
  fields(state.chosen);
  people(state.people);
  const fresh = !state.watching ? [] : state.drops.filter((drop) => !drops.has(drop.impact) || drops.get(drop.impact).taken !== drop.taken);
  for (const drop of state.drops) { drops.set(drop.impact, drop); row(drop); }
  if (state.last && state.last.name) {
    const words = `${state.last.name}: ${state.last.words}`;
    // Said again only where it is another: a screen reader reads it out.
    if ($("verdict").textContent !== words) $("verdict").textContent = words;
    $("verdict").className = state.last.kind;
    $("advice").textContent = state.last.advice;
  }
  if (fresh.length && following) choose(fresh.at(-1).impact, true);
  else if (!chosen && drops.size) choose([...drops.keys()].at(-1), false);
  else if (chosen && state.drops.some((drop) => drop.impact === chosen)) choose(chosen, following);
}

function fields(values) {
  $("choose").hidden = !values;
  if (!values || $("fields").children.length) return;
  for (const [name, value] of Object.entries(values)) {
    const label = element("label", name);
    label.append(element("input", undefined, { name, value, autocomplete: "off" }));
    $("fields").append(label);
  }
}

function people(rows) {
  $("who").hidden = !rows.length;
  const head = element("tr");
  for (const words of [nouns.person, "drops", "K (N/m), by its last mass", wanted ? `known to (wanted ${percent(wanted)})` : "known to"])
    head.append(element("th", words, { scope: "col" }));
  const body = rows.map((each) => {
    const line = element("tr");
    line.append(element("th", each.person, { scope: "row" }), element("td", each.drops), element("td", interval(each.K)));
    const enough = wanted && each.width <= wanted;
    line.append(element("td", each.width === undefined ? "–" : `${percent(each.width)}${enough ? ", enough" : ""}`, enough ? { class: "good" } : {}));
    return line;
  });
  $("people").replaceChildren(head, ...body);
}

const COLUMNS = ["drop", "verdict", "K (N/m)", "C (N s/m)"];

function row(drop) {
  const head = $("drops").tHead, body = $("drops").tBodies[0];
  if (!head.children.length) {
    const line = element("tr");
    for (const words of COLUMNS) line.append(element("th", words, { scope: "col" }));
    head.append(line);
  }
  const id = `drop-${drop.impact}`;
  const line = element("tr", undefined, { id, tabindex: "-1", "aria-selected": "false" });
  const said = drop.left_out ? `left out: ${drop.left_out}` : `${drop.kind}${drop.reason ? `: ${drop.reason}` : ""}`;
  line.append(element("td", drop.impact), element("td", said, { class: `said ${drop.left_out ? "" : drop.kind}` }), element("td", interval(drop.K)), element("td", interval(drop.C)));
  if (drop.left_out) line.className = "out";
  line.addEventListener("click", () => choose(drop.impact, false));
  line.addEventListener("focus", () => { if (chosen !== drop.impact) choose(drop.impact, false); });
  const earlier = document.getElementById(id);
  if (earlier) earlier.replaceWith(line); else body.prepend(line);
}

async function choose(impact, follow) {
  following = follow;
  const before = chosen && document.getElementById(`drop-${chosen}`);
  if (before) { before.setAttribute("aria-selected", "false"); before.tabIndex = -1; }
  chosen = impact;
  const line = document.getElementById(`drop-${impact}`);
  line.setAttribute("aria-selected", "true");
  line.tabIndex = 0;
  if (!follow) history.replaceState(null, "", `#${encodeURIComponent(impact)}`);
  const drop = drops.get(impact);
  $("one-title").textContent = `Trace of ${impact}`;
  $("leave-out").hidden = Boolean(drop.left_out);
  $("use").hidden = !drop.left_out;
  $("reason").value = drop.left_out || "";
  numbers(drop, {});
  $("trace").replaceChildren();
  $("trace-words").textContent = "…";
  let one;
  try { one = await (await bench.get(`drop?impact=${encodeURIComponent(impact)}`)).json(); } catch { return; }
  if (chosen !== impact) return;
  draw(one.trace);
  numbers(drop, one.study);
}

function numbers(drop, study) {
  const head = element("tr");
  for (const words of ["", "K (N/m)", "C (N s/m)"]) head.append(element("th", words, { scope: "col" }));
  const lines = [["by itself", drop.K, drop.C]];
  if (study && study.impact) lines.push(["in the study so far", study.impact.K, study.impact.C], [nouns.its, study.person.K, study.person.C]);
  const body = lines.map(([words, K, C]) => {
    const line = element("tr");
    line.append(element("th", words, { scope: "row" }), element("td", interval(K)), element("td", interval(C)));
    return line;
  });
  $("numbers").replaceChildren($("numbers").caption, head, ...body);
  outcomes(Object.entries(drop.outcomes || {}));
}

function outcomes(values) {
  const body = values.map(([words, numbers]) => {
    const line = element("tr");
    line.append(element("th", words, { scope: "row" }), element("td", interval(numbers)));
    return line;
  });
  $("outcomes").hidden = !values.length;
  $("outcomes").replaceChildren($("outcomes").caption, ...body);
}

function draw(trace) {
  const svg = $("trace"), space = "http://www.w3.org/2000/svg";
  const box = { left: 52, right: 590, top: 12, bottom: 222 };
  const shown = [...trace.recorded, ...trace.fitted].filter((value) => value !== null);
  const [t0, t1] = [trace.time_ms[0], trace.time_ms.at(-1)], low = Math.min(0, ...shown), high = Math.max(...shown);
  const x = (t) => (box.left + ((t - t0) / (t1 - t0 || 1)) * (box.right - box.left)).toFixed(1);
  const y = (a) => (box.bottom - ((a - low) / (high - low || 1)) * (box.bottom - box.top)).toFixed(1);
  const add = (name, attributes, text) => {
    const made = document.createElementNS(space, name);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    if (text !== undefined) made.textContent = text;
    parts.push(made);
  };
  const parts = [];
  add("line", { class: "axis", x1: box.left, x2: box.right, y1: y(0), y2: y(0) });
  add("line", { class: "axis", x1: box.left, x2: box.left, y1: box.top, y2: box.bottom });
  for (const a of [low, (low + high) / 2, high]) add("text", { x: box.left - 6, y: Number(y(a)) + 4, "text-anchor": "end" }, a.toFixed(0));
  for (const t of [t0, (t0 + t1) / 2, t1]) add("text", { x: x(t), y: box.bottom + 16, "text-anchor": t === t1 ? "end" : "middle" }, t.toFixed(1));
  add("text", { x: (box.left + box.right) / 2, y: 256, "text-anchor": "middle" }, "time since contact (ms)");
  add("text", { x: 14, y: 120, transform: "rotate(-90 14 120)", "text-anchor": "middle" }, "deceleration (m/s²)");
  trace.time_ms.forEach((t, k) => { if (trace.recorded[k] !== null) add("circle", { class: "recorded", cx: x(t), cy: y(trace.recorded[k]), r: 1.6 }); });
  const line = trace.time_ms.map((t, k) => (trace.fitted[k] === null ? "" : `${x(t)},${y(trace.fitted[k])}`)).filter(Boolean);
  if (line.length) add("polyline", { class: "fitted", points: line.join(" ") });
  svg.replaceChildren(...parts);
  $("trace-words").textContent = `Recorded (dots) and fitted (line) up to the greatest depth, ${t1.toFixed(1)} ms after contact; peak ${short(high)} m/s².`;
}

$("back").addEventListener("click", () => act("take-back", {}));
$("choose").addEventListener("submit", (event) => {
  event.preventDefault();
  act("choose", Object.fromEntries(new FormData(event.target)), $("choose-said"));
});
$("decide").addEventListener("submit", (event) => {
  event.preventDefault();
  const reason = $("reason").value.trim();
  if (chosen && reason) act("decide", { impact: chosen, reason }, $("decide-said"));
  else { $("decide-said").textContent = "give the reason first"; $("reason").focus(); }
});
$("use").addEventListener("click", () => chosen && act("decide", { impact: chosen, reason: "" }, $("decide-said")));
bench.onKey("u", () => act("take-back", {}));
for (const [key, sibling] of [["ArrowDown", "nextElementSibling"], ["ArrowUp", "previousElementSibling"]]) {
  bench.onKey(key, () => { if (chosen) document.getElementById(`drop-${chosen}`)[sibling]?.focus(); });
}

const named = decodeURIComponent(location.hash.slice(1));
const refresh = bench.follow(show, $("connection"));
refresh().then(() => { if (drops.has(named)) choose(named, false); });
