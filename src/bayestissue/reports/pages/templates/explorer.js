// Any impact of a fit: chosen in a figure, in a list or by an arrow key, with its recording and where it stands.
"use strict";
(async () => {
  const part = document.getElementById("explorer");
  if (!part) return;
  const buffer = await bayestissue.unpacked(document.getElementById("impacts-data"));
  const length = new DataView(buffer).getUint32(0, true);
  const data = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  // Each number is what it adds to the one before, its sign in the lowest bit; first all low bytes.
  const coded = new Uint8Array(buffer, 4 + length), numbers = new Int16Array(coded.length / 2);
  let last = 0;
  numbers.forEach((_, at) => {
    const added = coded[at] | coded[numbers.length + at] << 8;
    numbers[at] = last += (added >> 1) ^ -(added & 1);
  });
  data.impacts = bayestissue.rowsOf(data.impacts);
  const names = data.impacts.map(row => row.impact);
  const place = new Map(names.map((name, at) => [name, at]));
  let start = 0;
  const traces = new Map(data.traces.map(trace => {
    const held = [names[trace.impact], { ...trace, start }];
    start += trace.samples * (2 + data.bands.length);
    return held;
  }));

  const list = part.querySelector("#impact"), order = part.querySelector("#order");
  const lists = [...part.querySelectorAll("select[data-factor]")];
  const facts = part.querySelector("#facts"), missing = part.querySelector("#no-recording");
  const orders = {
    unlike: row => -row.unlike, name: null, "K": row => -row.K_N_per_m, "C": row => -row.C_N_s_per_m,
    mass: row => -row.mass_kg, sure: row => -row.K_high_N_per_m / row.K_low_N_per_m,
  };
  let chosen = "";

  const shown = () => data.impacts.filter(row => lists.every(one => one.value === "any" || row[one.dataset.factor] === one.value));
  const options = () => {
    const by = orders[order.value], rows = shown();
    if (by) rows.sort((a, b) => by(a) - by(b)); else rows.sort((a, b) => a.impact.localeCompare(b.impact, undefined, { numeric: true }));
    list.replaceChildren(...rows.map(row => new Option(row.impact, row.impact)));
    part.querySelector("#count").textContent = `${rows.length} of ${names.length}`;
    return rows;
  };

  const digits = (value, width) => value.toFixed(Math.min(Math.max(1 - Math.floor(Math.log10(width || Math.abs(value) || 1)), 0), 6)).replace("-", "\u2212");
  const range = (row, q, unit) => {
    const column = `${q}_${unit}`, low = row[column.replace("_", "_low_")], high = row[column.replace("_", "_high_")];
    return [digits(row[column], high - low), `${digits(low, high - low)} to ${digits(high, high - low)}`];
  };
  const rank = (row, column) => 1 + data.impacts.filter(other => other[column] > row[column]).length;
  const tell = row => {
    const line = (term, ...words) => {
      const dt = document.createElement("dt"), dd = document.createElement("dd");
      dt.textContent = term; dd.textContent = words.join(" ");
      return [dt, dd];
    };
    const p = data.tested[row.impact];
    const far = part.querySelector(row.unlike >= 3.5 ? "#far-words" : "#near-words").textContent;
    facts.replaceChildren(
      ...data.factors.slice().reverse().flatMap(name => line(name, row[name])),
      ...line("mass, velocity", `${digits(row.mass_kg, 0.01)} kg, ${digits(row.velocity_m_s, 0.01)} m/s`),
      ...[["K", "N_per_m", "N/m", "stiffness"], ["C", "N_s_per_m", "N s/m", "damping"]].flatMap(([q, unit, words, what]) => {
        const [value, interval] = range(row, q, unit);
        return line(`${what} ${q}`, `${value} ${words} (${interval});`, `rank ${rank(row, `${q}_${unit}`)} of ${names.length}, 1 the greatest`);
      }),
      ...line("among the others", far),
      ...(p === undefined ? [] : line("residuals", `p = ${p < 0.001 ? "below 0.001" : p.toPrecision(2)}${p < 0.01 ? ": structure that the model does not explain" : ""}`)),
    );
  };

  const rows = name => {
    const trace = traces.get(name);
    if (!trace) return [];
    const n = trace.samples, column = k => numbers.subarray(trace.start + k * n, trace.start + (k + 1) * n);
    const [step, finer] = trace.steps, middle = column(0);
    const beside = (k, i) => middle[i] * step + column(k)[i] * finer;
    return Array.from({ length: n }, (_, i) => ({
      time_ms: trace.first + i * trace.interval, median: middle[i] * step, recorded: beside(1, i),
      ...Object.fromEntries(data.bands.map((band, k) => [band, beside(k + 2, i)])),
    }));
  };

  const views = new Set();
  const signal = (view, name, value) => { try { view.signal(name, value); return true; } catch { return false; } };
  const update = view => {
    if (view.traced) view.data("trace", rows(chosen)).resize();
    else if (signal(view, "chosen", chosen)) lists.forEach((one, at) => signal(view, `only_${at}`, one.value));
    else return;
    view.runAsync();
  };
  const remember = () => {
    const kept = [["impact", chosen], ...lists.map(one => [one.dataset.factor, one.value])].filter(([, value]) => value !== "any");
    history.replaceState(null, "", `#explorer=${encodeURIComponent(JSON.stringify(Object.fromEntries(kept)))}`);
  };
  const choose = (name, keep = true) => {
    if (!place.has(name)) return;
    chosen = name;
    if (list.value !== name) {
      if (![...list.options].some(option => option.value === name)) { lists.forEach(one => { one.value = "any"; }); options(); }
      list.value = name;
    }
    tell(data.impacts[place.get(name)]);
    part.dispatchEvent(new CustomEvent("chosen", { detail: name }));
    missing.hidden = traces.has(name);
    views.forEach(update);
    if (keep) remember();
  };
  const step = by => {
    const at = list.selectedIndex + by;
    if (at >= 0 && at < list.options.length) choose(list.options[at].value);
  };

  list.addEventListener("change", () => choose(list.value));
  order.addEventListener("change", () => { options(); list.selectedIndex = 0; choose(list.value); });
  lists.forEach(one => one.addEventListener("change", () => {
    const rows = options();
    choose(rows.some(row => row.impact === chosen) ? chosen : rows.length ? list.value : chosen);
    views.forEach(update); remember();
  }));
  part.querySelector("#previous").addEventListener("click", () => step(-1));
  part.querySelector("#next").addEventListener("click", () => step(1));
  bayestissue.onView((view, figure) => {
    view.traced = figure.dataset.name === "recording";
    if (!view.traced && !signal(view, "chosen", chosen)) return;
    views.add(view);
    view.addEventListener("click", (event, item) => item && item.datum && choose(item.datum.impact));
    figure.querySelector(".drawing").addEventListener("keydown", event => {
      const by = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 }[event.key];
      if (by) { event.preventDefault(); step(by); }
    });
    update(view);
  });

  part.querySelector("form").addEventListener("submit", event => event.preventDefault());
  part.querySelectorAll("[disabled]").forEach(control => { control.disabled = false; });
  const begin = () => {
    let kept = {};
    try { kept = JSON.parse(decodeURIComponent(location.hash.split("explorer=")[1] || "%7B%7D")); } catch { /* another link */ }
    lists.forEach(one => { if ([...one.options].some(option => option.value === kept[one.dataset.factor])) one.value = kept[one.dataset.factor]; });
    options();
    choose(kept.impact || list.value || names[0], false);
  };
  begin();
  addEventListener("hashchange", () => { if (location.hash.startsWith("#explorer=")) begin(); });
})();
