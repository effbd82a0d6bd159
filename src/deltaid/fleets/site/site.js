// Tables that one can search and sort, without leaving the page.
(() => {
  "use strict";
  const make = (tag, properties, parent) => {
    const element = Object.assign(document.createElement(tag), properties);
    parent.append(element);
    return element;
  };
  const text = (cell) => cell.textContent.trim();
  const order = new Intl.Collator(undefined, { numeric: true });

  // Numbers by their size, what is no number last; all else as words, with numbers inside them.
  const compare = (a, b, up) => {
    if (a.dataset.value !== undefined || b.dataset.value !== undefined) {
      const [x, y] = [parseFloat(a.dataset.value), parseFloat(b.dataset.value)];
      if (Number.isNaN(x) || Number.isNaN(y)) return Number.isNaN(x) - Number.isNaN(y);
      return up ? x - y : y - x;
    }
    const [x, y] = [text(a), text(b)];
    if (x === "—" || y === "—") return (x === "—") - (y === "—");
    return up ? order.compare(x, y) : order.compare(y, x);
  };

  const dress = (figure) => {
    const body = figure.querySelector("tbody");
    const rows = [...body.rows];
    const heads = [...figure.querySelectorAll("thead th")];
    if (rows.length < 2) return;
    const words = rows.map((row) => row.textContent.toLowerCase());
    const finder = document.createElement("div");
    finder.className = "finder";
    figure.prepend(finder);
    const search = make("input", { type: "search", placeholder: "Search" }, finder);
    search.setAttribute("aria-label", "Search in this table");
    const choices = (figure.dataset.choices || "").split(" ").filter(Boolean).map((column) => {
      const values = [...new Set(rows.map((row) => text(row.cells[column])))].sort(order.compare);
      const choice = make("select", {}, finder);
      choice.setAttribute("aria-label", text(heads[column]));
      make("option", { value: "", textContent: `${text(heads[column])}: all` }, choice);
      values.forEach((value) => make("option", { value: `=${value}`, textContent: value }, choice));
      return { column, choice };
    });
    const count = make("output", {}, finder);
    const show = () => {
      const wanted = search.value.toLowerCase().split(/\s+/).filter(Boolean);
      let shown = 0;
      rows.forEach((row, k) => {
        const fits =
          wanted.every((word) => words[k].includes(word)) &&
          choices.every(({ column, choice }) =>
            !choice.value || choice.value.slice(1) === text(row.cells[column]));
        row.hidden = !fits;
        shown += fits;
      });
      count.textContent = shown === rows.length ? `${shown}` : `${shown} of ${rows.length}`;
    };
    search.addEventListener("input", show);
    choices.forEach(({ choice }) => choice.addEventListener("change", show));
    heads.forEach((head, column) => {
      const button = document.createElement("button");
      button.type = "button";
      button.append(...head.childNodes);
      head.append(button);
      button.addEventListener("click", () => {
        const up = head.getAttribute("aria-sort") !== "ascending";
        heads.forEach((other) => other.removeAttribute("aria-sort"));
        head.setAttribute("aria-sort", up ? "ascending" : "descending");
        const sorted = [...rows].sort((a, b) => compare(a.cells[column], b.cells[column], up));
        body.append(...sorted);
      });
    });
    show();
  };
  document.querySelectorAll("figure.searchable").forEach(dress);
})();
