// What makes the pages move. Without it they are read all the same: the first page then asks again by itself.
"use strict";

const live = document.getElementById("live");

// Token: kept as long as the tab is open, and sent with wishes alone.
for (const field of document.querySelectorAll("input.token")) {
  field.value = sessionStorage.getItem("token") ?? "";
  field.addEventListener("change", () => sessionStorage.setItem("token", field.value));
}

function headers() {
  const token = sessionStorage.getItem("token");
  return token ? { Authorization: `Bearer ${token}` } : {};
}

// The live part: the server writes it, and only what has changed is put in place.
async function renew() {
  const answer = await fetch("/?part=live", { cache: "no-store" });
  if (!answer.ok) return;
  const fresh = new DOMParser().parseFromString(await answer.text(), "text/html");
  const sections = [...fresh.body.children];
  const names = new Set(sections.map((section) => section.id));
  for (const old of [...live.children]) if (!names.has(old.id)) old.remove();
  let before = null;
  for (const section of sections) {
    const old = document.getElementById(section.id);
    if (!old) {
      const own = document.importNode(section, true);
      if (before) before.after(own);
      else live.prepend(own);
      before = own;
    } else {
      // A heading that says the same is left alone, so that nobody hears it twice.
      const [heading, said] = [section.querySelector("[role=status]"), old.querySelector("[role=status]")];
      if (heading && said && heading.outerHTML === said.outerHTML) {
        while (said.nextSibling) said.nextSibling.remove();
        let next;
        while ((next = heading.nextSibling)) said.parentNode.append(document.adoptNode(next));
      } else if (old.innerHTML !== section.innerHTML) {
        old.innerHTML = section.innerHTML;
      }
      before = old;
    }
  }
}

function showForms(capture) {
  for (const form of document.querySelectorAll("form[data-when]")) {
    form.hidden = (form.dataset.when === "running") !== Boolean(capture);
    form.dataset.id = capture ? capture.id : "";
  }
}

if (live) {
  let busy = false;
  const source = new EventSource("/v1/events/stream");
  source.addEventListener("status", async (event) => {
    showForms(JSON.parse(event.data).capture);
    document.body.classList.remove("lost");
    if (busy || document.hidden) return;
    busy = true;
    try {
      await renew();
    } catch {
      // The next event tries again.
    } finally {
      busy = false;
    }
  });
  source.addEventListener("error", () => document.body.classList.add("lost"));
  addEventListener("pagehide", () => source.close());
}

// Wishes: forms that are sent as JSON.
for (const section of document.querySelectorAll(".wishes")) {
  section.hidden = false;
  const said = section.querySelector(".said");
  for (const form of section.querySelectorAll("form")) {
    form.addEventListener("submit", async (event) => {
      event.preventDefault();
      if (form.dataset.ask && !confirm(form.dataset.ask)) return;
      const body = form.dataset.json ? JSON.parse(form.dataset.json) : {};
      for (const [name, value] of new FormData(form)) {
        if (value === "") continue;
        body[name] = name === "start_at" ? new Date(value).toISOString() : value;
      }
      const path = form.dataset.post.replace("{id}", form.dataset.id ?? "");
      const empty = Object.keys(body).length === 0;
      const answer = await fetch(path, {
        method: "POST",
        headers: empty ? headers() : { ...headers(), "Content-Type": "application/json" },
        body: empty ? undefined : JSON.stringify(body),
      });
      const told = await answer.json().catch(() => ({}));
      if (!answer.ok) {
        said.textContent = told.detail ?? `The daemon answered ${answer.status}.`;
        said.classList.add("alarm");
      } else if (form.dataset.then) {
        location.assign(form.dataset.then + told.id);
      } else if (live) {
        said.classList.remove("alarm");
        said.textContent = "Done.";
        renew();
      } else {
        location.reload();
      }
    });
  }
}

// The simulators that a capture can be compared with.
for (const select of document.querySelectorAll("select[data-models]")) {
  fetch("/v1/models").then(async (answer) => {
    const { models = [] } = answer.ok ? await answer.json() : {};
    for (const model of models) select.append(new Option(model.name ? `${model.id} (${model.name})` : model.id, model.id));
    if (models.length === 0) select.closest("form").hidden = true;
  });
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
