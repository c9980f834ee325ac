// In print, figures have the width of the paper, and folded sections are open.
let unfolded = [];
addEventListener("beforeprint", () => {
  printing = true;
  unfolded = [...document.querySelectorAll("details.printed:not([open])")];
  for (const details of unfolded) details.open = true;
  drawPlots("all");
});
addEventListener("afterprint", () => {
  printing = false;
  for (const details of unfolded) details.open = false;
  drawPlots("all");
});
