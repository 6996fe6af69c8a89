// Sorts and filters the table of episodes.

class EpisodeTable {
  constructor(table, form) {
    this.body = table.tBodies[0];
    this.form = form;
    for (const button of table.querySelectorAll("th button")) button.addEventListener("click", () => this.sort(button.parentElement));
    form.addEventListener("input", () => this.filter());
    form.addEventListener("submit", (event) => event.preventDefault());
    form.addEventListener("reset", () => setTimeout(() => this.filter()));
  }

  // Empty cells stay at the end.
  sort(heading) {
    const column = heading.cellIndex, up = heading.getAttribute("aria-sort") !== "ascending";
    for (const other of heading.parentElement.cells) other.removeAttribute("aria-sort");
    heading.setAttribute("aria-sort", up ? "ascending" : "descending");
    const value = (row) => row.cells[column].dataset.v ?? row.cells[column].textContent;
    const compare = (a, b) => {
      const [x, y] = [value(a), value(b)], [noX, noY] = [x, y].map((v) => v === "" || v === "–");
      if (noX || noY) return noX - noY;
      return (up ? 1 : -1) * (isFinite(x) && isFinite(y) ? x - y : x.localeCompare(y, "en"));
    };
    this.body.append(...[...this.body.rows].sort(compare));
  }

  filter() {
    const wanted = Object.fromEntries(new FormData(this.form)), words = (wanted.text ?? "").toLowerCase().split(/\s+/).filter(Boolean);
    let left = 0;
    for (const row of this.body.rows) {
      const text = row.textContent.toLowerCase();
      const fits = ["target", "policy", "outcome", "fault", "verdict", "kind"].every((name) => !wanted[name] || row.dataset[name] === wanted[name])
        && (!wanted.breach || row.dataset.breach.split(" ").includes(wanted.breach));
      row.hidden = !(fits && words.every((word) => text.includes(word)));
      left += !row.hidden;
    }
    this.form.querySelector("output").textContent = `${left} of ${this.body.rows.length} episodes`;
  }

  // Returns the numbers of the episodes that can be played, in the order of the rows that are left.
  playable() {
    return [...this.body.rows].filter((row) => !row.hidden && row.querySelector("[data-play]")).map((row) => Number(row.dataset.number));
  }
}
