// @ts-check
// Replaces the part of a page that changes by its present version, while something runs.

const EVERY = 2000; // [ms]

async function refresh() {
  const live = document.getElementById("live");
  if (!live?.dataset.again) return;
  if (document.visibilityState === "visible") {
    try {
      const answer = await fetch(location.href);
      const page = new DOMParser().parseFromString(await answer.text(), "text/html");
      const fresh = page.getElementById("live");
      if (answer.ok && fresh) {
        const held = document.activeElement?.id;
        const lines = document.getElementById("log")?.scrollTop ?? 0;
        live.replaceWith(fresh);
        if (held) document.getElementById(held)?.focus();
        const log = document.getElementById("log");
        if (log) log.scrollTop = lines;
      }
    } catch {
      // The server may be away for a moment; the next attempt shows the present state.
    }
  }
  setTimeout(refresh, EVERY);
}

setTimeout(refresh, EVERY);
