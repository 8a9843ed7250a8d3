// What the report of a fit has besides where `bayestissue open` serves it: questions, and decisions on impacts.
(() => {
  const $ = id => document.getElementById(id), { element } = bench;

  // The questions stand in the address, so that it opens the same answers again; the part behind # is the impact.
  const questions = () => new URLSearchParams(location.search).getAll("q");
  async function answer(list) {
    const query = new URLSearchParams(list.map(text => ["q", text]));
    const part = await (await bench.get(`answers.html?${query}`)).text();
    $("answers").innerHTML = part;
    history.replaceState(null, "", `${location.pathname}${list.length ? `?${query}` : ""}${location.hash}`);
  }
  const said = work => work.catch(error => { $("connection").textContent = `not connected: ${error.message}`; });
  $("ask").addEventListener("submit", event => {
    event.preventDefault();
    const text = $("question").value.trim();
    if (text) said(answer([...questions(), text]).then(() => { if (!$("answers").querySelector(".card:last-child .refused")) $("question").value = ""; }));
  });
  $("answers").addEventListener("click", event => {
    const off = event.target.closest("a.off");
    if (!off) return;
    event.preventDefault();
    said(answer(new URL(off.href).searchParams.getAll("q")));
    $("question").focus();
  });

  let chosen = "", leftOut = new Map();
  const controls = () => {
    const reason = leftOut.get(chosen);
    $("leave-out").textContent = reason ? "Change the reason" : "Leave this impact out";
    $("accept").hidden = !reason;
    if (document.activeElement !== $("reason")) $("reason").value = reason || "";
  };
  async function act(action, content, place) {
    place.textContent = await bench.act(action, content) || "done";
    await refresh();
  }
  const show = state => {
    leftOut = new Map(state.left_out.map(one => [one.impact, one.reason]));
    $("decide").hidden = !state.dataset;
    $("no-decisions").hidden = Boolean(state.dataset);
    $("no-decisions").textContent = state.why_not;
    $("decisions").hidden = !state.left_out.length && !state.accepted.length && !state.undone;
    const line = (impact, words, again) => {
      const item = element("li", undefined, { "data-impact": impact });
      item.append(element("a", impact, { href: `#explorer=${encodeURIComponent(JSON.stringify({ impact }))}` }), ` ${words} `);
      if (again) {
        const button = element("button", "Accept it again", { type: "button", class: "plain" });
        button.addEventListener("click", () => act("decide", { impact, reason: "" }, $("undo-said")));
        item.append(button);
      }
      return item;
    };
    $("decided").replaceChildren(
      ...state.left_out.map(one => line(one.impact, `is left out: ${one.reason}. ${one.fitted ? "The fit shown still contains it." : "The fit shown does without it."}`, true)),
      ...state.accepted.map(impact => line(impact, "is accepted again. The fit shown does without it.", false)),
    );
    $("anew").replaceChildren(...(state.anew ? ["Fit anew: ", element("code", state.anew)] : ["The fit shown is of these impacts."]));
    controls();
  };
  const refresh = bench.follow(show, $("connection"));
  document.getElementById("explorer").addEventListener("chosen", event => { chosen = event.detail; $("decide-said").textContent = ""; controls(); });
  $("decide").addEventListener("submit", event => {
    event.preventDefault();
    const reason = $("reason").value.trim();
    if (reason) act("decide", { impact: chosen, reason }, $("decide-said"));
    else { $("decide-said").textContent = "give the reason first"; $("reason").focus(); }
  });
  $("accept").addEventListener("click", () => act("decide", { impact: chosen, reason: "" }, $("decide-said")));
  const undo = () => act("take-back", {}, $("undo-said"));
  $("undo").addEventListener("click", undo);
  bench.onKey("u", undo);
})();
