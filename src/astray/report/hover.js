// Tells the values of a figure under the pointer, or by the arrow keys.
for (const plot of document.querySelectorAll("[data-points]")) {
  const points = JSON.parse(plot.dataset.points);
  const [image, told] = [plot.querySelector("img"), plot.querySelector("output")];
  let at = -1;
  const show = (k) => {
    at = Math.min(Math.max(k, 0), points.length - 1);
    const [x, y, text] = points[at];
    told.textContent = text;
    told.style.left = `${image.offsetLeft + (x * image.offsetWidth) / 100}px`;
    told.style.top = `${image.offsetTop + (y * image.offsetHeight) / 100}px`;
    told.className = `${x > 50 ? "left" : "right"} ${y > 50 ? "up" : "down"}`;
  };
  const hide = () => { told.textContent = told.className = ""; };
  plot.addEventListener("pointermove", ({ clientX, clientY }) => {
    const box = image.getBoundingClientRect();
    const away = ([x, y]) => Math.hypot(
      box.left + (x * box.width) / 100 - clientX, box.top + (y * box.height) / 100 - clientY);
    const near = points.reduce((best, one, k) => (away(one) < away(points[best]) ? k : best), 0);
    if (away(points[near]) < 40) show(near);
    else hide();
  });
  plot.addEventListener("pointerleave", hide);
  plot.addEventListener("blur", hide);
  plot.addEventListener("keydown", (event) => {
    const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (event.key === "Escape") hide();
    if (!step) return;
    event.preventDefault();
    show(at + step);
    told.scrollIntoView({ block: "nearest", inline: "nearest" });
  });
}
