// Assembles the page, and redraws it when its width changes.

function showAll() {
  fillHeader();
  fillSettings();
  fillMetrics();
  fillNotSent();
  fillEvents();
  fillFollow();
  makePlots(byId("figures"));
  fillBuses();
  fillDetails();
  showTimeLine();
  showVehicles(cursor.time);
  drawAnimation();
  document.documentElement.dataset.drawn = String(plots.length);
}

function offerLayers() {
  byId("layers").hidden = false;
  byId("layer-a").nextSibling.textContent = ` ${nameOf(data)}`;
  byId("layer-b").nextSibling.textContent = ` ${nameOf(data.other)}, dashed`;
  for (const [id, layer] of [["layer-a", "A"], ["layer-b", "B"], ["layer-second", "second"]]) {
    byId(id).addEventListener("change", (event) => {
      layers[layer] = event.target.checked;
      drawPlots("all");
      drawAnimation();
    });
  }
}

let sizedFor = innerWidth;
addEventListener("resize", () => {
  if (innerWidth === sizedFor) return;
  sizedFor = innerWidth;
  drawPlots("all");
  showTimeLine();
  drawAnimation();
});

document.documentElement.classList.add("alive");
byId("hint").textContent = finePointer.matches
  ? "Point at a figure to move the time; drag to zoom, double-click or press Esc to zoom out. Space plays, arrows step."
  : "Touch a figure to move the time, a mark to read it.";
if (data.other) offerLayers();
showAll();
setTime(cursor.time);
