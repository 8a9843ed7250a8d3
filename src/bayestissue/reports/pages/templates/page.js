// Draws a page's figures from what it carries, sorts its tables, opens what a link or a printer needs.
"use strict";
const bayestissue = (() => {
  const root = document.documentElement;
  root.classList.add("scripted");
  // What is packed is compressed; of that, five letters are four bytes.
  const places = new Uint8Array(128);
  [..."0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz!#$%.()*+-;,=:?@^_`{|}~"].forEach((letter, at) => { places[letter.charCodeAt(0)] = at; });
  const unpacked = element => {
    const letters = element.textContent, bytes = new DataView(new ArrayBuffer(4 * Math.ceil(letters.length / 5)));
    for (let at = 0; at < letters.length; at += 5) {
      let four = 0;
      for (let k = at; k < at + 5; k++) four = 85 * four + (k < letters.length ? places[letters.charCodeAt(k)] : 84);
      bytes.setUint32(4 * at / 5, four);
    }
    const packed = new Blob([bytes.buffer.slice(0, Math.floor(letters.length * 4 / 5))]);
    return new Response(packed.stream().pipeThrough(new DecompressionStream("gzip"))).arrayBuffer();
  };
  const text = async element => new TextDecoder().decode(await unpacked(element));
  const fetched = new Map();
  const once = (key, make) => fetched.has(key) ? fetched.get(key) : (fetched.set(key, make()), fetched.get(key));

  // Drawn by what the page carries, or by what its server has.
  const library = () => once("library", async () => {
    const script = document.createElement("script"), carried = document.getElementById("library");
    script.src = carried ? URL.createObjectURL(new Blob([await text(carried)], { type: "text/javascript" })) : "library.js";
    await new Promise((done, failed) => { script.onload = done; script.onerror = failed; document.head.append(script); });
    URL.revokeObjectURL(script.src);
  });

  // As `bayestissue.base.results.tables.as_text`: a spreadsheet computes no name.
  const plain = value => typeof value === "string" && /^'*[=+@\t\r-]/.test(value) && isNaN(value) ? `'${value}` : value;
  const csv = rows => {
    const names = [...new Set(rows.flatMap(Object.keys))];
    const cell = value => value === null || value === undefined ? "" : /[",\n\r]/.test(value) ? `"${String(value).replaceAll('"', '""')}"` : value;
    return [names, ...rows.map(row => names.map(name => row[name]))].map(row => row.map(plain).map(cell).join(",")).join("\n");
  };
  const download = (name, rows) => {
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob(["\ufeff", csv(rows)], { type: "text/csv" }));
    link.download = name;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  };

  // Figures by name, each of their tables by column.
  const figures = () => once("figures", async () => JSON.parse(await text(document.getElementById("figures-data"))));
  const rowsOf = table => (Object.values(table)[0] || []).map((_, at) => Object.fromEntries(Object.entries(table).map(([name, column]) => [name, column[at]])));

  // The rows behind a figure as a table, made when it is asked for; the download has all of them.
  const MOST = 100;
  const short = value => typeof value !== "number" ? value ?? "" : String(Number(value.toPrecision(4))).replace("-", "\u2212");
  const tabled = (part, rows) => {
    const names = Object.keys(rows[0] || {}), table = document.createElement("table"), body = table.createTBody(), scroll = document.createElement("div");
    const add = (row, kind, name, value) => {
      const cell = document.createElement(kind);
      cell.textContent = value; if (typeof rows[0][name] !== "number") cell.className = "text"; else if (kind === "th") cell.className = "number";
      row.append(cell);
    };
    const head = table.createTHead().insertRow();
    names.forEach(name => add(head, "th", name, name));
    rows.slice(0, MOST).forEach(one => { const row = body.insertRow(); names.forEach(name => add(row, "td", name, short(one[name]))); });
    scroll.className = "scroll"; scroll.tabIndex = 0; scroll.append(table);
    if (rows.length > MOST) table.createCaption().textContent = `The first ${MOST} of ${rows.length} rows`;
    part.querySelector(".scroll")?.remove();
    part.append(scroll);
    sortable(table);
  };

  // Views by figure; whoever listens is told of each new one.
  const views = new Map(), listeners = [];
  const draw = figure => once(figure, async () => {
    const place = figure.querySelector(".drawing");
    // Two figures may show the same, and each changes what it draws.
    const [all] = await Promise.all([figures(), library()]), spec = structuredClone(all[figure.id]);
    for (const [name, table] of Object.entries(spec.datasets)) spec.datasets[name] = rowsOf(table);
    // As wide as the page leaves room, and no wider than the figure is meant to be by much.
    // What is hidden has no width yet: it gets that of what holds it.
    let holder = place;
    while (!holder.clientWidth && holder !== document.body) holder = holder.parentElement;
    const room = Math.max(holder === place ? holder.clientWidth : Math.min(holder.clientWidth, 520), 240);
    // On a narrow screen fewer names stand beside each other, and both pictures of the first screen are in sight.
    if (room < 420) {
      spec.config.legend.columns = 2;
      if (figure.closest(".pictures")) { spec.height = spec.height < 300 ? Math.max(0.6 * spec.height, 40) : 122; spec.config.axis.labelSeparation = 0; }
    }
    if (spec.facet) { spec.columns = Math.min(spec.columns, Math.max(Math.floor(room / 220), 1)); spec.spec.width = (room - 60) / spec.columns - (spec.resolve.scale.y ? 65 : 25); }
    else if (spec.vconcat) spec.vconcat.forEach(part => { part.width = Math.min(room, 900) - 92; });
    else { spec.width = Math.min(room, 1.5 * (spec.width || 460)); spec.autosize = { type: "fit-x", contains: "padding" }; }
    const name = figure.dataset.name || "figure";
    const { view } = await vegaEmbed(place, spec, {
      renderer: "svg", ast: true, logLevel: 1, downloadFileName: name,
      actions: { export: true, source: false, compiled: false, editor: false },
      ...(spec.usermeta || {}).embedOptions,
    });
    place.querySelector("summary")?.setAttribute("aria-label", "Save this figure");
    const longest = Object.values(spec.datasets).sort((a, b) => b.length - a.length)[0] || [];
    const rows = () => spec.vconcat ? view.data("trace").map(row => ({ ...row })) : longest;
    const part = figure.querySelector(".numbers"), button = document.createElement("button");
    button.type = "button"; button.textContent = "Download the numbers (CSV)"; button.className = "plain";
    button.addEventListener("click", () => download(`${name}.csv`, rows()));
    part.querySelector("summary").after(button);
    part.addEventListener("toggle", () => { if (part.open) tabled(part, rows()); });
    if (part.open) tabled(part, rows());
    views.set(figure, view);
    listeners.forEach(listen => listen(view, figure));
    return view;
  });
  const onView = listen => { listeners.push(listen); views.forEach((view, figure) => listen(view, figure)); };

  const charts = [...document.querySelectorAll(".chart")];
  const near = new IntersectionObserver(entries => entries.forEach(entry => {
    if (entry.isIntersecting) { near.unobserve(entry.target); draw(entry.target); }
  }), { rootMargin: "400px" });
  charts.forEach(figure => near.observe(figure));
  // Once the page stands, the others follow one by one, so that a printer finds them all.
  const idle = window.requestIdleCallback || (work => setTimeout(work, 50));
  const next = () => { const one = charts.find(figure => !fetched.has(figure)); if (one) draw(one).then(() => idle(next)); };
  addEventListener("load", () => idle(next));

  // A link into a closed part opens it first.
  const lift = () => {
    const target = document.getElementById(decodeURIComponent(location.hash.slice(1)).split("=")[0]);
    let part = target && (target.matches("details") ? target : target.closest("details"));
    if (part && !part.open) { for (; part; part = part.parentElement.closest("details")) part.open = true; target.scrollIntoView(); }
  };
  addEventListener("hashchange", lift); lift();

  // A click on a heading sorts its table, the next one the other way; without a script tables keep their order.
  const number = cell => { const found = cell.replace(/\u2212/g, "-").replace(/(\d),(?=\d{3})/g, "$1").match(/-?\d+(\.\d+)?(e-?\d+)?/i); return found ? parseFloat(found[0]) : NaN; };
  const compare = (a, b, numeric) => { const [x, y] = numeric ? [number(a), number(b)] : [NaN, NaN]; return isNaN(x) || isNaN(y) ? (numeric ? isNaN(x) - isNaN(y) : 0) || a.localeCompare(b, undefined, { numeric: true }) : x - y; };
  const sortable = table => {
    const body = table.tBodies[0], heads = table.tHead ? [...table.tHead.rows[0].cells] : [];
    if (!body || body.rows.length < 3) return;
    heads.forEach((head, column) => {
      const button = document.createElement("button");
      button.type = "button"; button.title = "Sort by this column";
      button.append(...head.childNodes); head.append(button);
      button.addEventListener("click", () => {
        const down = head.getAttribute("aria-sort") === "ascending", cell = row => row.cells[column].textContent.trim();
        heads.forEach(other => other.removeAttribute("aria-sort"));
        head.setAttribute("aria-sort", down ? "descending" : "ascending");
        // Empty cells come last either way.
        const filled = [...body.rows].filter(row => cell(row)), empty = [...body.rows].filter(row => !cell(row));
        filled.sort((a, b) => (down ? -1 : 1) * compare(cell(a), cell(b), head.classList.contains("number")));
        body.append(...filled, ...empty);
      });
    });
  };
  document.querySelectorAll("table").forEach(sortable);

  // A printed page has no lids to lift; the numbers behind its figures stay in the file.
  const lids = "details:not([open]):not(.numbers)";
  addEventListener("beforeprint", () => {
    document.querySelectorAll(lids).forEach(d => { d.open = true; d.dataset.printed = ""; });
    // The summary of the first page shows a figure that stands below.
    document.querySelectorAll(".again[data-of]").forEach(copy => {
      const svg = document.querySelector(`#${copy.dataset.of} .drawing svg.marks`);
      if (svg) copy.replaceChildren(svg.cloneNode(true));
    });
  });
  addEventListener("afterprint", () => document.querySelectorAll("details[data-printed]").forEach(d => { d.open = false; delete d.dataset.printed; }));
  return { unpacked, rowsOf, draw, onView, root };
})();
