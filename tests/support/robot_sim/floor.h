// Where a simulated robot may drive: a costmap with a keep-out zone and a person who walks through
// it, and the shortest way from one cell to another. Pure: no clock, no DDS.
#ifndef RIPS_TESTS_SUPPORT_ROBOT_SIM_FLOOR_H_
#define RIPS_TESTS_SUPPORT_ROBOT_SIM_FLOOR_H_

#include <cstddef>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"

namespace rips::robot_sim {

struct Cell {
  int x = 0;
  int y = 0;

  friend bool operator==(const Cell&, const Cell&) = default;
};

// Both corners included.
struct CellRect {
  Cell low;
  Cell high;

  bool Has(Cell cell) const {
    return cell.x >= low.x && cell.x <= high.x && cell.y >= low.y && cell.y <= high.y;
  }
};

// Read from a file such as deploy/paper/floor.yaml, which says what each key means.
struct FloorPlan {
  int width = 0;
  int height = 0;
  double cell_m = 0;
  std::vector<CellRect> free;
  CellRect keep_out;
  std::map<std::string, Cell> places;
  struct Person {
    Cell from;
    Cell to;
    int cells = 0;
    int64_t takes_ns = 0;
  } person;
};
// InvalidArgument with all problems; `file` is the name used in them.
absl::StatusOr<FloorPlan> ParseFloorPlan(absl::string_view text, absl::string_view file);

// What is in the way on it at one moment.
struct InTheWay {
  // The keep-out filter is on.
  bool keep_out = false;
  // The middle of the person, if they are there.
  std::optional<Cell> person;
};

// Immutable.
class Floor {
 public:
  explicit Floor(FloorPlan plan);

  const FloorPlan& plan() const { return plan_; }
  bool IsFree(Cell cell, const InTheWay& in_the_way) const;
  // Cells of nav_msgs/msg/OccupancyGrid, row by row from below: 0 = free, 100 = occupied.
  std::string Grid(const InTheWay& in_the_way) const;
  // The cells after `from` up to `to`, each beside the one before; empty if there is no way, or it
  // is there. From a cell that is not free the way first leads to the nearest one that is.
  std::vector<Cell> Way(Cell from, Cell to, const InTheWay& in_the_way) const;
  // Where the person is after so long; nullopt if they have gone.
  std::optional<Cell> PersonAfter(int64_t since_ns) const;

  // The middle of a cell in metres, and the cell of a point.
  struct Point {
    double x = 0;
    double y = 0;
  };
  Point MiddleOf(Cell cell) const;
  Cell CellOf(Point point) const;

 private:
  size_t IndexOf(Cell cell) const {
    return static_cast<size_t>(cell.y) * static_cast<size_t>(plan_.width) +
           static_cast<size_t>(cell.x);
  }
  bool Exists(Cell cell) const {
    return cell.x >= 0 && cell.y >= 0 && cell.x < plan_.width && cell.y < plan_.height;
  }

  const FloorPlan plan_;
  std::vector<bool> free_;
};

}  // namespace rips::robot_sim

#endif  // RIPS_TESTS_SUPPORT_ROBOT_SIM_FLOOR_H_
