#include "policy_server/ripsctl/top/fleet_view.h"

#include <algorithm>
#include <compare>
#include <tuple>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "policy_server/ripsctl/cli/printer.h"
#include "policy_server/ripsctl/cli/robot_level.h"
#include "services/text/utf8.h"

namespace rips::ripsctl {
namespace {

constexpr size_t kUnknownRank = SIZE_MAX;
constexpr const char* kColumns[] = {"ROBOT", "DECIDED", "EFFECTIVE", "STAGE", "DEGRADED"};
constexpr size_t kColumnCount = std::size(kColumns);
constexpr size_t kMarkWidth = 2;
// Of a cell's text: one line is not longer.
constexpr size_t kCellBytesMax = 1'000;
constexpr absl::string_view kTimeFormat = "%Y-%m-%d %H:%M:%SZ";

// `text` on at most `width` columns; `>` at the end says that something is cut off.
std::string Fit(absl::string_view text, size_t width) {
  if (CountCodePoints(text) <= width) return std::string(text);
  if (width == 0) return "";
  return absl::StrCat(CutCodePoints(text, width - 1), ">");
}

std::string Padded(absl::string_view text, size_t width) {
  const std::string fit = Fit(text, width);
  return absl::StrCat(fit, std::string(width - CountCodePoints(fit), ' '));
}

std::string UtcTime(absl::Time time) {
  return absl::FormatTime(kTimeFormat, time, absl::UTCTimeZone());
}

// How wide a column but the last may be, so that the last is not pushed off the terminal.
size_t WidthMax(size_t column, size_t columns) {
  if (column == 0) return std::max<size_t>(24, columns / 3);
  return std::max<size_t>(14, columns / 7);
}

std::string Plural(size_t count, absl::string_view noun) {
  return absl::StrCat(count, " ", noun, count == 1 ? "" : "s");
}

}  // namespace

// Greater is more urgent; the name decides between equal ones.
struct FleetView::Urgency {
  bool failed = false;
  size_t rank = 0;
  bool unverified = false;
  bool degraded = false;
  bool pending = false;
  auto operator<=>(const Urgency&) const = default;
};

void FleetView::Connected() {
  lost_ = false;
  ++connection_;
}

void FleetView::Lost(absl::string_view why, absl::Time now) {
  if (std::exchange(lost_, true)) return;  // since the first time
  lost_why_ = std::string(why);
  lost_at_ = now;
}

bool FleetView::Update(v1::RobotStatus status) {
  const size_t bytes = status.ByteSizeLong();
  const auto before = robots_.find(status.robot());
  const size_t without = bytes_ - (before == robots_.end() ? 0 : before->second.bytes);
  if (without + bytes > bytes_max_) return false;
  bytes_ = without + bytes;
  const std::string id = status.robot();
  robots_[id] = {std::move(status), connection_, bytes};
  return true;
}

void FleetView::SetLevels(const std::string& bundle, std::vector<std::string> levels) {
  std::map<std::string, size_t>& ranks = ranks_[bundle];
  ranks.clear();
  for (size_t i = 0; i < levels.size(); ++i) ranks.emplace(std::move(levels[i]), i);
}

size_t FleetView::RankOf(const std::string& bundle, const std::string& level) const {
  const auto ranks = ranks_.find(bundle);
  if (ranks == ranks_.end()) return kUnknownRank;
  const auto rank = ranks->second.find(level);
  return rank == ranks->second.end() ? kUnknownRank : rank->second;
}

FleetView::Urgency FleetView::UrgencyOf(const Robot& robot) const {
  const v1::RobotStatus& status = robot.status;
  const std::string& bundle = status.bundle_version();
  size_t rank = RankOf(bundle, status.decided_level());
  // Empty: no actuator is attached, which `degraded` says.
  if (!status.effective_level().empty()) {
    rank = std::max(rank, RankOf(bundle, status.effective_level()));
  }
  return {.failed = status.stage() == "failed",
          .rank = rank,
          .unverified = status.stage() != "verified",
          .degraded = !status.degraded().empty() || status.degraded_cut(),
          .pending = status.pending_approvals() > 0};
}

std::vector<const FleetView::Robot*> FleetView::MostUrgent(size_t count) const {
  std::vector<std::pair<Urgency, const Robot*>> all;
  all.reserve(robots_.size());
  for (const auto& [id, robot] : robots_) all.emplace_back(UrgencyOf(robot), &robot);
  count = std::min(count, all.size());
  std::partial_sort(all.begin(), all.begin() + static_cast<std::ptrdiff_t>(count), all.end(),
                    [](const auto& a, const auto& b) {
                      if (a.first != b.first) return a.first > b.first;
                      return a.second->status.robot() < b.second->status.robot();
                    });
  std::vector<const Robot*> most;
  for (size_t i = 0; i < count; ++i) most.push_back(all[i].second);
  return most;
}

std::string FleetView::LossText(absl::Time now) const {
  const absl::Duration age = std::max(now - lost_at_, absl::ZeroDuration());
  return absl::StrCat("NOT CURRENT since ", UtcTime(lost_at_), ", ", absl::ToInt64Seconds(age),
                      " s ago: the connection is lost (", EscapeText(lost_why_), "); trying again");
}

// `3 robots: 1 HALT, 2 DEFAULT; 1 degraded`, the most restrictive level first.
std::string FleetView::Counts() const {
  std::map<std::string, std::pair<size_t, size_t>> levels;  // rank and number, by name
  size_t failed = 0;
  size_t degraded = 0;
  size_t pending = 0;
  size_t stale = 0;
  for (const auto& [id, robot] : robots_) {
    const Urgency urgency = UrgencyOf(robot);
    auto& [rank, number] = levels[robot.status.decided_level()];
    rank = std::max(rank, RankOf(robot.status.bundle_version(), robot.status.decided_level()));
    ++number;
    failed += urgency.failed ? 1 : 0;
    degraded += urgency.degraded ? 1 : 0;
    pending += urgency.pending ? 1 : 0;
    stale += IsStale(robot) ? 1 : 0;
  }
  std::vector<std::tuple<size_t, std::string, size_t>> ordered;
  for (const auto& [name, level] : levels) ordered.emplace_back(level.first, name, level.second);
  std::sort(ordered.rbegin(), ordered.rend());
  std::string text = Plural(robots_.size(), "robot");
  const char* before = ": ";
  for (const auto& [rank, name, number] : ordered) {
    absl::StrAppend(&text, before, number, " ", EscapeText(name));
    before = ", ";
  }
  const std::pair<size_t, const char*> rest[] = {{failed, "failed"},
                                                 {degraded, "degraded"},
                                                 {pending, "to be approved"},
                                                 {lost_ ? 0 : stale, "not heard of again"}};
  for (const auto& [number, what] : rest) {
    if (number > 0) absl::StrAppend(&text, "; ", number, " ", what);
  }
  return text;
}

std::vector<ScreenLine> FleetView::Header(absl::Time now) const {
  std::vector<ScreenLine> lines;
  // First, so that the lowest terminal has it.
  if (lost_) lines.push_back({LossText(now), LineStyle::kReverse});
  lines.push_back(
      {absl::StrCat("ripsctl top  ", EscapeText(server_), "  ", UtcTime(now), "  q ends"),
       lost_ ? LineStyle::kDim : LineStyle::kBold});
  if (connection_ == 0 && !lost_) {
    lines.push_back({"waiting for the first status"});
  } else {
    lines.push_back({Counts(), lost_ ? LineStyle::kDim : LineStyle::kPlain});
  }
  return lines;
}

std::vector<std::string> FleetView::CellsOf(const Robot& robot) const {
  const v1::RobotStatus& status = robot.status;
  std::vector<std::string> wrong;
  if (robot.connection != connection_) wrong.push_back("no status since the connection was lost");
  if (status.pending_approvals() > 0) {
    wrong.push_back(
        absl::StrCat(Plural(status.pending_approvals(), "lowering"), " to be approved"));
  }
  if (status.has_maintenance()) wrong.push_back(MaintenanceText(status));
  wrong.insert(wrong.end(), status.degraded().begin(), status.degraded().end());
  if (status.degraded_cut()) wrong.push_back("(more than fits here)");
  std::vector<std::string> cells = {status.robot(), status.decided_level(),
                                    status.effective_level(), status.stage(),
                                    absl::StrJoin(wrong, "; ")};
  for (std::string& cell : cells) {
    cell = cell.empty() ? "-" : EscapeText(absl::string_view(cell).substr(0, kCellBytesMax));
  }
  return cells;
}

std::vector<ScreenLine> FleetView::Rows(const std::vector<const Robot*>& robots,
                                        size_t columns) const {
  std::vector<std::vector<std::string>> table = {{std::begin(kColumns), std::end(kColumns)}};
  for (const Robot* robot : robots) table.push_back(CellsOf(*robot));
  size_t widths[kColumnCount] = {};
  for (const auto& row : table) {
    for (size_t i = 0; i + 1 < kColumnCount; ++i) {
      widths[i] = std::max(widths[i], std::min(CountCodePoints(row[i]), WidthMax(i, columns)));
    }
  }
  std::vector<ScreenLine> lines;
  for (size_t i = 0; i < table.size(); ++i) {
    const Robot* robot = i == 0 ? nullptr : robots[i - 1];
    const bool stale = robot == nullptr ? lost_ : IsStale(*robot);
    std::string text(kMarkWidth, ' ');
    if (robot != nullptr && UrgencyOf(*robot).failed) text[0] = '!';
    if (robot != nullptr && stale) text[0] = '?';
    for (size_t j = 0; j + 1 < kColumnCount; ++j) {
      absl::StrAppend(&text, Padded(table[i][j], widths[j]), "  ");
    }
    absl::StrAppend(&text, table[i].back());
    const bool raised = robot != nullptr && (UrgencyOf(*robot).rank > 0 || text[0] == '!');
    lines.push_back({std::move(text), stale    ? LineStyle::kDim
                                      : raised ? LineStyle::kBold
                                               : LineStyle::kPlain});
  }
  return lines;
}

std::vector<ScreenLine> FleetView::Render(TerminalSize size, absl::Time now) const {
  std::vector<ScreenLine> lines = Header(now);
  const size_t above = lines.size();
  size_t room = size.rows > above + 1 ? size.rows - above - 1 : 0;  // the table has a header
  if (room < robots_.size() && room > 0) --room;                    // for what is left out
  const std::vector<const Robot*> shown = MostUrgent(room);
  for (ScreenLine& row : Rows(shown, size.columns)) lines.push_back(std::move(row));
  if (lines.size() > size.rows) lines.resize(size.rows);
  if (shown.size() < robots_.size()) {
    ScreenLine left_out = {absl::StrCat(Plural(robots_.size() - shown.size(), "more robot"),
                                        ", less urgent, for which the terminal has no room"),
                           LineStyle::kReverse};
    if (lines.size() < size.rows) {
      lines.push_back(std::move(left_out));
    } else if (lines.size() > above) {
      lines.back() = std::move(left_out);  // in place of a table without rows
    }
  }
  for (ScreenLine& line : lines) line.text = Fit(line.text, size.columns);
  return lines;
}

std::string ScreenBytes(const std::vector<ScreenLine>& lines) {
  std::string bytes = "\x1b[H";
  for (size_t i = 0; i < lines.size(); ++i) {
    if (i > 0) absl::StrAppend(&bytes, "\r\n");
    switch (lines[i].style) {
      case LineStyle::kPlain:
        break;
      case LineStyle::kBold:
        absl::StrAppend(&bytes, "\x1b[1m");
        break;
      case LineStyle::kDim:
        absl::StrAppend(&bytes, "\x1b[2m");
        break;
      case LineStyle::kReverse:
        absl::StrAppend(&bytes, "\x1b[7m");
        break;
    }
    absl::StrAppend(&bytes, lines[i].text, "\x1b[0m\x1b[K");
  }
  return absl::StrCat(bytes, "\x1b[J");
}

}  // namespace rips::ripsctl
