// Draws the figures of notebooks: each is JSON in the page.

for (const place of document.querySelectorAll(".drawing")) {
  const figure = JSON.parse(place.querySelector("script").textContent);
  place.querySelector("script").remove();
  window.Plotly.newPlot(place, figure.data, figure.layout, { responsive: true, displaylogo: false });
}
