#include "tests/support/robot_sim/floor.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <queue>
#include <utility>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "absl/time/time.h"
#include "services/base/status_macros.h"
#include "services/runtime/config_reader.h"

namespace rips::robot_sim {
namespace {

constexpr int kCellsMax = 4'096;  // of a side
constexpr char kFree = 0;
constexpr char kOccupied = 100;

std::optional<std::vector<int>> Numbers(absl::string_view text, size_t count) {
  std::vector<int> numbers;
  for (const absl::string_view word : absl::StrSplit(text, ' ', absl::SkipWhitespace())) {
    int number = 0;
    if (!absl::SimpleAtoi(word, &number)) return std::nullopt;
    numbers.push_back(number);
  }
  if (numbers.size() != count) return std::nullopt;
  return numbers;
}

bool IsOn(const FloorPlan& plan, Cell cell) {
  return cell.x >= 0 && cell.y >= 0 && cell.x < plan.width && cell.y < plan.height;
}

void ReadCell(const ConfigSection& section, const std::string& key, const FloorPlan& plan,
              Cell* cell) {
  std::string text;
  section.Required(key, &text);
  if (text.empty()) return;
  const auto numbers = Numbers(text, 2);
  if (numbers) *cell = {.x = (*numbers)[0], .y = (*numbers)[1]};
  if (!numbers || !IsOn(plan, *cell)) section.Problem(key, "must be a cell of the floor: `x y`");
}

std::optional<CellRect> Rectangle(const std::string& text, const FloorPlan& plan) {
  const auto numbers = Numbers(text, 4);
  if (!numbers) return std::nullopt;
  const CellRect rect = {.low = {.x = (*numbers)[0], .y = (*numbers)[1]},
                         .high = {.x = (*numbers)[2], .y = (*numbers)[3]}};
  if (!IsOn(plan, rect.low) || !IsOn(plan, rect.high) || rect.low.x > rect.high.x ||
      rect.low.y > rect.high.y) {
    return std::nullopt;
  }
  return rect;
}

}  // namespace

absl::StatusOr<FloorPlan> ParseFloorPlan(absl::string_view text, absl::string_view file) {
  constexpr char kRectangle[] = "must be a rectangle on the floor: `x0 y0 x1 y1`";
  ConfigReader reader(file, text);
  const ConfigSection root = reader.root();
  FloorPlan plan;
  int cell_mm = 0;
  root.Required("width", &plan.width, {1, kCellsMax});
  root.Required("height", &plan.height, {1, kCellsMax});
  root.Required("cell_mm", &cell_mm, {1, 1'000});
  plan.cell_m = cell_mm / 1e3;
  std::vector<std::string> free;
  root.Required("free", &free);
  for (const std::string& each : free) {
    const std::optional<CellRect> rect = Rectangle(each, plan);
    if (rect) plan.free.push_back(*rect);
    if (!rect) root.Problem("free", kRectangle);
  }
  std::string keep_out;
  root.Required("keep_out", &keep_out);
  const std::optional<CellRect> zone = Rectangle(keep_out, plan);
  if (zone) plan.keep_out = *zone;
  if (!zone) root.Problem("keep_out", kRectangle);
  const ConfigSection places = root.RequiredSection("places");
  for (const std::string& name : places.present() ? places.Keys() : std::vector<std::string>()) {
    ReadCell(places, name, plan, &plan.places[name]);
  }
  const ConfigSection person = root.RequiredSection("person");
  absl::Duration takes;
  ReadCell(person, "from", plan, &plan.person.from);
  ReadCell(person, "to", plan, &plan.person.to);
  person.Required("cells", &plan.person.cells, {1, 100});
  person.Required("takes", &takes, {absl::Milliseconds(1), absl::Hours(1)});
  plan.person.takes_ns = absl::ToInt64Nanoseconds(takes);
  RIPS_RETURN_IF_ERROR(reader.Finish());
  return plan;
}

Floor::Floor(FloorPlan plan)
    : plan_(std::move(plan)),
      free_(static_cast<size_t>(plan_.width) * static_cast<size_t>(plan_.height)) {
  for (const CellRect& rect : plan_.free) {
    for (int y = rect.low.y; y <= rect.high.y; ++y) {
      for (int x = rect.low.x; x <= rect.high.x; ++x) free_[IndexOf({x, y})] = true;
    }
  }
}

bool Floor::IsFree(Cell cell, const InTheWay& in_the_way) const {
  if (!Exists(cell) || !free_[IndexOf(cell)]) return false;
  if (in_the_way.keep_out && plan_.keep_out.Has(cell)) return false;
  if (!in_the_way.person) return true;
  // As many cells to one side of the middle as to the other, or one more.
  const int before = plan_.person.cells / 2;
  const Cell low = {in_the_way.person->x - before, in_the_way.person->y - before};
  const int more = plan_.person.cells - 1;
  return !CellRect{.low = low, .high = {low.x + more, low.y + more}}.Has(cell);
}

std::string Floor::Grid(const InTheWay& in_the_way) const {
  std::string cells(free_.size(), kOccupied);
  for (int y = 0; y < plan_.height; ++y) {
    for (int x = 0; x < plan_.width; ++x) {
      if (IsFree({x, y}, in_the_way)) cells[IndexOf({x, y})] = kFree;
    }
  }
  return cells;
}

std::vector<Cell> Floor::Way(Cell from, Cell to, const InTheWay& in_the_way) const {
  if (!Exists(from) || !Exists(to)) return {};
  // Breadth first. Cells that are not free may be crossed only until the first free one.
  const bool leaving = !IsFree(from, in_the_way);
  std::vector<int> before(free_.size(), -1);
  std::queue<Cell> next;
  before[IndexOf(from)] = static_cast<int>(IndexOf(from));
  next.push(from);
  std::optional<Cell> found;
  while (!next.empty() && !found) {
    const Cell at = next.front();
    next.pop();
    const bool is_free = IsFree(at, in_the_way);
    if (at == to || (leaving && is_free)) {
      found = at;
      break;
    }
    constexpr std::array<Cell, 4> kSteps = {Cell{1, 0}, Cell{-1, 0}, Cell{0, 1}, Cell{0, -1}};
    for (const Cell& step : kSteps) {
      const Cell there = {at.x + step.x, at.y + step.y};
      if (!Exists(there) || before[IndexOf(there)] >= 0) continue;
      if (leaving ? !free_[IndexOf(there)] : !IsFree(there, in_the_way)) continue;
      before[IndexOf(there)] = static_cast<int>(IndexOf(at));
      next.push(there);
    }
  }
  std::vector<Cell> way;
  for (std::optional<Cell> at = found; at && !(*at == from);) {
    way.push_back(*at);
    const int index = before[IndexOf(*at)];
    at = Cell{index % plan_.width, index / plan_.width};
  }
  std::reverse(way.begin(), way.end());
  return way;
}

std::optional<Cell> Floor::PersonAfter(int64_t since_ns) const {
  const FloorPlan::Person& person = plan_.person;
  if (since_ns < 0 || since_ns > person.takes_ns) return std::nullopt;
  const double part = static_cast<double>(since_ns) / static_cast<double>(person.takes_ns);
  return Cell{
      .x = person.from.x + static_cast<int>(std::lround(part * (person.to.x - person.from.x))),
      .y = person.from.y + static_cast<int>(std::lround(part * (person.to.y - person.from.y)))};
}

Floor::Point Floor::MiddleOf(Cell cell) const {
  return {.x = (cell.x + 0.5) * plan_.cell_m, .y = (cell.y + 0.5) * plan_.cell_m};
}

Cell Floor::CellOf(Point point) const {
  return {.x = static_cast<int>(std::floor(point.x / plan_.cell_m)),
          .y = static_cast<int>(std::floor(point.y / plan_.cell_m))};
}

}  // namespace rips::robot_sim
