// Plays the recording beside a page's picture: loads the site's own copy of the rerun viewer when the button is pressed.
"use strict";

function whatIsMissing() {
  if (location.protocol === "file:")
    return "To play the recording here, serve the folder: python -m http.server -d build/site";
  if (!window.WebAssembly || !window.DecompressionStream)
    return "To play the recording here, a newer browser is needed.";
  if (!document.createElement("canvas").getContext("webgl2"))
    return "To play the recording here, a browser with WebGL 2 is needed; this one has none, or it is switched off.";
  return "";
}

function makePlayer(place) {
  const button = place.querySelector("button");
  const status = place.querySelector("[role=status]");
  const picture = place.querySelector("img").parentElement;
  const label = button.textContent;
  const stage = document.createElement("div");
  stage.setAttribute("role", "region");
  stage.setAttribute("aria-label", "The recording, in the rerun viewer");
  let stop = null; // ends the viewer; null while the picture is shown

  // The viewer takes all keys, Tab too; Escape leads out of it.
  const leave = (event) => event.key === "Escape" && button.focus();

  // The viewer starts on its own; until it is ready, what nobody catches is its failure.
  const failed = (event) => fail(event.reason);

  async function play() {
    const loading = (stop = () => {});
    button.textContent = "Close the recording";
    status.textContent = "The viewer is loading.";
    try {
      const viewer = (await import(new URL(place.dataset.viewer, location.href))).default;
      if (stop !== loading) return; // closed meanwhile
      picture.hidden = true;
      picture.after(stage);
      document.addEventListener("keydown", leave, true);
      window.addEventListener("unhandledrejection", failed);
      stop = viewer.render({ model: makeModel(), el: stage });
    } catch (error) {
      fail(error);
    }
  }

  // What the viewer, made for notebooks, asks of one; its time bar has no buttons in a narrow window.
  function makeModel() {
    const time = place.clientWidth < 600 ? "expanded" : "collapsed";
    const settings = {
      _url: new URL(place.dataset.recording, location.href).href,
      _width: "auto",
      _height: "auto", // style.css has it
      _theme: document.body.dataset.mdColorScheme === "slate" ? "dark" : "light",
      _panel_states: { top: "hidden", blueprint: "hidden", selection: "hidden", time },
    };
    const send = (event) => {
      if (event !== "ready") return;
      window.removeEventListener("unhandledrejection", failed);
      status.textContent = "Space plays and pauses, Escape leaves the viewer.";
    };
    return { get: (name) => settings[name], on() {}, off() {}, send };
  }

  function fail(error) {
    close();
    status.textContent = `The viewer could not be loaded: ${error.message ?? error}`;
  }

  function close() {
    stop?.();
    stop = null;
    window.removeEventListener("unhandledrejection", failed);
    document.removeEventListener("keydown", leave, true);
    stage.replaceChildren();
    stage.remove();
    picture.hidden = false;
    status.textContent = "";
    button.textContent = label;
  }

  button.addEventListener("click", () => (stop ? close() : play()));
  picture.addEventListener("click", () => stop || play());
  picture.style.cursor = "pointer";
  button.hidden = false;
}

for (const place of document.querySelectorAll(".recording")) {
  const missing = whatIsMissing();
  if (missing) place.querySelector("[role=status]").textContent = missing;
  else makePlayer(place);
}
