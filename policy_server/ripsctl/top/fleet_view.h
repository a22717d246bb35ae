// What `ripsctl top` knows of a fleet, and how it looks on a terminal. Pure: no clock, no thread.
#ifndef RIPS_POLICY_SERVER_RIPSCTL_TOP_FLEET_VIEW_H_
#define RIPS_POLICY_SERVER_RIPSCTL_TOP_FLEET_VIEW_H_

#include <cstddef>
#include <map>
#include <string>
#include <vector>

#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "rips/v1/operator.pb.h"

namespace rips::ripsctl {

struct TerminalSize {
  size_t columns = 80;
  size_t rows = 24;
};

// How a line is shown. Dim is for what may not be true any more.
enum class LineStyle { kPlain, kBold, kDim, kReverse };

// Of at most as many code points as the terminal has columns; no control characters.
struct ScreenLine {
  std::string text;
  LineStyle style = LineStyle::kPlain;
};

// One thread at a time.
class FleetView {
 public:
  // Of all statuses as messages: a server must not fill the memory.
  static constexpr size_t kBytesMax = 256 << 20;

  // `server` as the operator names it.
  explicit FleetView(std::string server, size_t bytes_max = kBytesMax)
      : server_(std::move(server)), bytes_max_(bytes_max) {}

  // A stream of statuses delivers: the first one, or one after a loss. Robots count as stale until
  // their status comes on it.
  void Connected();
  // From `now` on all is stale.
  void Lost(absl::string_view why, absl::Time now);
  // False, and not kept: with it the statuses would have more bytes than the limit.
  bool Update(v1::RobotStatus status);
  // The levels of a bundle, least restrictive first.
  void SetLevels(const std::string& bundle, std::vector<std::string> levels);
  bool HasLevels(const std::string& bundle) const { return ranks_.contains(bundle); }

  // At most `size.rows` lines, the most urgent robots first:
  //   1. those whose actuators failed to reach the level (stage `failed`)
  //   2. the more restrictive level, decided or effective; an unknown one is above all
  //   3. those not `verified` yet, then degraded ones, then those with a lowering to be approved
  //   4. by name
  std::vector<ScreenLine> Render(TerminalSize size, absl::Time now) const;

 private:
  struct Robot {
    v1::RobotStatus status;
    int connection = 0;  // on which its status came
    size_t bytes = 0;
  };
  struct Urgency;

  Urgency UrgencyOf(const Robot& robot) const;
  size_t RankOf(const std::string& bundle, const std::string& level) const;
  bool IsStale(const Robot& robot) const { return lost_ || robot.connection != connection_; }
  // Lines above the table.
  std::vector<ScreenLine> Header(absl::Time now) const;
  std::string LossText(absl::Time now) const;
  std::string Counts() const;
  std::vector<const Robot*> MostUrgent(size_t count) const;
  // The table of `robots`, with its header.
  std::vector<ScreenLine> Rows(const std::vector<const Robot*>& robots, size_t columns) const;
  std::vector<std::string> CellsOf(const Robot& robot) const;

  const std::string server_;
  const size_t bytes_max_;
  std::map<std::string, Robot> robots_;
  size_t bytes_ = 0;
  // By bundle, the place of each of its levels; 0 is the least restrictive one.
  std::map<std::string, std::map<std::string, size_t>> ranks_;
  int connection_ = 0;  // 0: there was none yet
  bool lost_ = false;
  std::string lost_why_;
  absl::Time lost_at_;
};

// The bytes that show `lines` in place of what an ANSI terminal shows.
std::string ScreenBytes(const std::vector<ScreenLine>& lines);

}  // namespace rips::ripsctl

#endif  // RIPS_POLICY_SERVER_RIPSCTL_TOP_FLEET_VIEW_H_
