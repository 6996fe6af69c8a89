// Puts the page together once it is there.

function begin() {
  const table = document.getElementById("episodes"), root = document.getElementById("player");
  if (!table || !root) return;
  const rows = new EpisodeTable(table, document.getElementById("filter"));
  const facts = JSON.parse(document.getElementById("index").textContent);
  const player = new Player(root, new Map(facts.map((one) => [one.number, one])), () => rows.playable());
  root.player = player; // for the console, and for tests
  document.addEventListener("click", (event) => {
    const link = event.target.closest("[data-play]");
    if (!link) return;
    event.preventDefault();
    player.load(Number(link.dataset.play));
    root.scrollIntoView({ block: "nearest" });
    root.focus({ preventScroll: true });
  });
  const open = async (number) => {
    await player.load(number);
    root.scrollIntoView({ block: "start" });
  };
  const wanted = () => Number(/^#play-(\d+)$/.exec(location.hash)?.[1] ?? NaN);
  addEventListener("hashchange", () => { if (player.index.has(wanted())) open(wanted()); });
  if (typeof DecompressionStream === "undefined") {
    root.querySelector("[data-part=title]").textContent = "This browser is too old for the player; the pictures below need none.";
  } else if (facts.length) {
    if (player.index.has(wanted())) open(wanted());
    else player.load(facts[0].number, false);
  }
}
begin();
