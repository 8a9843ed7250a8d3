"use strict";
// What the pages of `bayestissue watch` and `open` share: state comes as JSON, a bell tells when there is more.

const bench = (() => {
  async function get(path) {
    const answer = await fetch(path, { credentials: "same-origin" });
    if (!answer.ok) throw new Error(await answer.text());
    return answer;
  }

  // Empty where it was done, else why it was not.
  async function act(action, content) {
    const answer = await fetch(`act/${action}`, { method: "POST", credentials: "same-origin", body: JSON.stringify(content) });
    return answer.ok ? "" : answer.text();
  }

  // Show the state now, whenever the bell rings, and by the function that is returned. One request at a time;
  // what comes meanwhile is one more behind it.
  function follow(show, connection) {
    let version = 0, busy = false, again = false, rang = Date.now();
    async function refresh() {
      if (busy) { again = true; return; }
      busy = true;
      try {
        do {
          again = false;
          const state = await (await get(`state?since=${version}`)).json();
          show(state);
          version = state.version;
        } while (again);
        connection.textContent = "";
      } catch (error) {
        connection.textContent = `not connected: ${error.message}`;
      } finally {
        busy = false;
      }
    }
    const bell = new EventSource("events");
    bell.onmessage = () => { rang = Date.now(); refresh(); };
    // Where a proxy holds events back, or the connection broke.
    setInterval(() => { if (Date.now() - rang > 20000 || bell.readyState !== 1) refresh(); }, 2000);
    return refresh;
  }

  const element = (name, text, attributes = {}) => {
    const made = document.createElement(name);
    if (text !== undefined) made.textContent = text;
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    return made;
  };

  // A key that is pressed for the page, and not typed into a field.
  function onKey(key, work) {
    document.addEventListener("keydown", event => {
      if (event.key !== key || event.target.matches("input, select, textarea") || event.ctrlKey || event.metaKey || event.altKey) return;
      event.preventDefault();
      work();
    });
  }

  // The token is in the cookie now, and no address that is kept should have it.
  const address = new URL(location);
  address.searchParams.delete("token");
  if (address.href !== location.href) history.replaceState(null, "", address);
  return { get, act, follow, element, onKey };
})();
