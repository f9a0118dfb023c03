// For the keyboard: formulas that are wider than the page. For screen readers: names of the search, and of the bar of buttons that each block of code gets.
document.querySelector(".md-search").ariaLabel = "search";
for (const formula of document.querySelectorAll(".formula")) if (formula.scrollWidth > formula.clientWidth) formula.tabIndex = 0;
let bars = 0;
new MutationObserver(() => {
  for (const bar of document.querySelectorAll(".md-code__nav:not([aria-label])")) bar.ariaLabel = `code ${++bars}`;
}).observe(document.body, { childList: true, subtree: true });
