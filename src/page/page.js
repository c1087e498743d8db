// What makes the pages move. Without it they are read all the same: the first page then asks again by itself.
"use strict";

const live = document.getElementById("live");

// Token: kept as long as the tab is open, and sent with changes alone.
for (const field of document.querySelectorAll("input.token")) {
  field.value = sessionStorage.getItem("token") ?? "";
  field.addEventListener("change", () => sessionStorage.setItem("token", field.value));
}

function headers() {
  const token = sessionStorage.getItem("token");
  return token ? { Authorization: `Bearer ${token}` } : {};
}

// Makes a part of the page what it is now, and touches only what has changed: the focus and a selection stay where they
// are, and a heading that says the same is not heard twice.
function become(old, fresh) {
  if (old.nodeName !== fresh.nodeName) return old.replaceWith(document.importNode(fresh, true));
  // What somebody is filling in, and what somebody has opened, is theirs.
  if (old.classList?.contains("controls")) return;
  if (old.nodeType === Node.TEXT_NODE) {
    if (old.data !== fresh.data) old.data = fresh.data;
    return;
  }
  for (const { name } of [...old.attributes]) if (name !== "open" && !fresh.hasAttribute(name)) old.removeAttribute(name);
  for (const { name, value } of fresh.attributes) if (old.getAttribute(name) !== value) old.setAttribute(name, value);
  within(old, fresh);
}

function within(old, fresh) {
  const [had, has] = [[...old.childNodes], [...fresh.childNodes]];
  const [at, to] = [had, has].map((nodes) => nodes.findIndex((node) => node.classList?.contains("controls")));
  if (at >= 0 && to >= 0) {
    // What is before the controls may become more or fewer parts: the controls stay the same ones.
    parts(old, had.slice(0, at), has.slice(0, to), had[at]);
    parts(old, had.slice(at + 1), has.slice(to + 1), null);
  } else {
    parts(old, had, has, null);
  }
}

function parts(parent, had, has, behind) {
  has.forEach((node, place) => {
    if (place < had.length) become(had[place], node);
    else parent.insertBefore(document.importNode(node, true), behind);
  });
  for (const gone of had.slice(has.length)) gone.remove();
}

// The live part: the server writes it.
async function renew() {
  const answer = await fetch("/?part=live", { cache: "no-store" });
  if (!answer.ok) throw new Error(`the daemon answered ${answer.status}`);
  const fresh = new DOMParser().parseFromString(await answer.text(), "text/html");
  within(live, fresh.body);
}

function showForms(capture) {
  for (const form of document.querySelectorAll("form[data-when]")) {
    form.hidden = (form.dataset.when === "running") !== Boolean(capture);
    form.dataset.id = capture ? capture.id : "";
  }
}

// What is shown is old where the daemon is not heard any more, however good it sounds.
const lost = document.getElementById("lost");

function heard(yes) {
  const was = document.body.classList.contains("lost");
  document.body.classList.toggle("lost", !yes);
  if (yes) lost.textContent = "";
  else if (!was) {
    const at = new Date().toISOString().slice(0, 19).replace("T", " ");
    lost.textContent = `The daemon is not heard since ${at} UTC; what follows is from before.`;
  }
}

if (live) {
  let busy = false;
  const again = async () => {
    if (busy || document.hidden) return;
    busy = true;
    try {
      await renew();
      heard(true);
    } catch {
      heard(false);
    } finally {
      busy = false;
    }
  };
  const source = new EventSource("/v1/events/stream");
  source.addEventListener("status", (event) => {
    showForms(JSON.parse(event.data).capture);
    again();
  });
  source.addEventListener("error", () => {
    // Refused, as where too many listen, it does not come back: the page is asked for instead.
    if (source.readyState === EventSource.CLOSED) setInterval(again, 5000);
    else heard(false);
  });
  addEventListener("pagehide", () => source.close());
}

// A page that waits for an analysis asks again until it is there.
const waiting = document.querySelector("main[data-waits]");

async function ask() {
  try {
    const answer = await fetch(location.href, { cache: "no-store" });
    if (answer.ok) become(waiting, new DOMParser().parseFromString(await answer.text(), "text/html").querySelector("main"));
  } catch {
    // The next time.
  }
  if (waiting.dataset.waits) setTimeout(ask, 1000 * waiting.dataset.waits);
}

if (waiting) setTimeout(ask, 1000 * waiting.dataset.waits);

// A picture that could not be had, because much is asked at once, is asked for again, a few times.
document.addEventListener(
  "error",
  (event) => {
    const image = event.target;
    const tries = Number(image.dataset?.tries ?? 0);
    if (!(image instanceof HTMLImageElement) || tries >= 5) return;
    image.dataset.tries = tries + 1;
    setTimeout(() => (image.src = `${image.src.split("#")[0]}#${tries + 1}`), 2000 * (tries + 1));
  },
  true,
);

// The text of a file; of one that gzip packed, what it holds.
async function unpacked(file) {
  const bytes = file.name.endsWith(".gz") ? file.stream().pipeThrough(new DecompressionStream("gzip")) : file.stream();
  return new TextDecoder("utf-8", { fatal: true }).decode(await new Response(bytes).arrayBuffer());
}

// Sends a change; the daemon's answer, or why there is none.
async function change(form) {
  const method = form.dataset.method ?? "POST";
  const body = form.dataset.json ? JSON.parse(form.dataset.json) : {};
  for (const [name, value] of new FormData(form)) {
    // An empty field asks for nothing. A change has only what was changed here: the rest may have changed elsewhere.
    if (method === "POST" ? value === "" : value === form.elements[name].defaultValue) continue;
    if (value.size === 0) continue;
    if (value instanceof File) {
      try {
        body[name] = name === "reference" ? await unpacked(value) : JSON.parse(await value.text());
      } catch {
        const wanted = name === "reference" ? "no text: choose a motion's CSV" : "no JSON: choose a sensor model's file";
        return { refused: `${value.name} is ${wanted}.` };
      }
    } else {
      body[name] = name === "start_at" ? new Date(value).toISOString() : value;
    }
  }
  const path = form.dataset.post.replace("{id}", form.dataset.id ?? "");
  const empty = Object.keys(body).length === 0;
  if (empty && method === "PATCH") return { refused: "Nothing was changed here." };
  try {
    const answer = await fetch(path, {
      method,
      headers: empty ? headers() : { ...headers(), "Content-Type": "application/json" },
      body: empty ? undefined : JSON.stringify(body),
    });
    const told = await answer.json().catch(() => ({}));
    // What was saved is what the next change starts from.
    if (answer.ok && method === "PATCH") for (const field of form.querySelectorAll("input:not([type])")) field.defaultValue = field.value;
    return answer.ok ? told : { refused: told.detail ?? `The daemon answered ${answer.status}.` };
  } catch {
    return { refused: "The daemon is not reached: whether it has heard this is not known." };
  }
}

// Controls: forms that are sent as JSON.
for (const section of document.querySelectorAll(".controls")) {
  section.hidden = false;
  const said = section.querySelector(".said");
  for (const form of section.querySelectorAll("form")) {
    form.addEventListener("submit", async (event) => {
      event.preventDefault();
      if (form.dataset.ask && !confirm(form.dataset.ask)) return;
      const told = await change(form);
      said.classList.toggle("alarm", "refused" in told);
      if (told.refused) said.textContent = told.refused;
      else if (form.dataset.then) location.assign(form.dataset.then + told.id);
      else if (live) said.textContent = "Done.";
      else location.reload();
      // What has changed is told by the next status, soon.
    });
  }
}


// Zoom: drag across a time series.
for (const image of document.querySelectorAll("img.zoom")) {
  const [left, right] = [84 / 560, 546 / 560];
  const time = (event) => {
    const box = image.getBoundingClientRect();
    const share = ((event.clientX - box.left) / box.width - left) / (right - left);
    const [from, to] = [Number(image.dataset.from), Number(image.dataset.to)];
    return from + (to - from) * Math.min(1, Math.max(0, share));
  };
  let begun = null;
  image.draggable = false;
  image.addEventListener("pointerdown", (event) => {
    begun = time(event);
    image.setPointerCapture(event.pointerId);
    event.preventDefault();
  });
  image.addEventListener("pointerup", (event) => {
    if (begun === null) return;
    const ends = [begun, time(event)].sort((a, b) => a - b);
    begun = null;
    if (ends[1] - ends[0] > 0) location.assign(`${image.dataset.base}?from=${ends[0]}&to=${ends[1]}`);
  });
}
