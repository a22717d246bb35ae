// Commands that come twice, late, out of order or from a server that was replaced, for each pair of
// levels. What processes and devices do wrong is in tests/integration/matrix_test.py.
#include <functional>
#include <iostream>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "mode_actuator/decide/level_controller_test_rig.h"

namespace rips::actuator {
namespace {

using ::testing::Contains;

constexpr DecisionId kHeld = {1, 1};
constexpr DecisionId kOrdered = {1, 5};

struct Fault {
  std::string name;
  // Orders `to` as kOrdered at a robot that holds `from` as kHeld, and does what the fault is.
  std::function<void(ExecutorRig& rig, const std::string& from, const std::string& to)> play;
  // Where a raise and a lowering end.
  enum class End { kTo, kFrom };
  End raise;
  End lowering;
  std::string receipt;  // that must be among those given
};

std::vector<Fault> Faults() {
  using End = Fault::End;
  return {
      {"the same command twice",
       [](ExecutorRig& rig, const std::string&, const std::string& to) {
         rig.Level(to, kOrdered, kHeld);
         rig.Level(to, kOrdered, kHeld);
       },
       End::kTo, End::kTo, "id-1.5 verified"},
      {"the same decision by another command",
       [](ExecutorRig& rig, const std::string&, const std::string& to) {
         rig.Level(to, kOrdered, kHeld);
         rig.Level(to, kOrdered, kOrdered, "again");
       },
       End::kTo, End::kTo, "again verified"},
      {"an older decision after it",
       [](ExecutorRig& rig, const std::string& from, const std::string& to) {
         rig.Level(to, kOrdered, kHeld);
         rig.Level(from, {1, 4}, kHeld);
       },
       End::kTo, End::kTo, "id-1.4 refused_stale"},
      {"an older decision while it is applied",
       [](ExecutorRig& rig, const std::string& from, const std::string& to) {
         rig.auto_finish = false;
         rig.Level(to, kOrdered, kHeld);
         rig.Level(from, {1, 4}, kHeld);
         rig.auto_finish = true;
         if (rig.job().has_value()) rig.Finish(true);
       },
       End::kTo, End::kTo, "id-1.4 refused_stale"},
      {"a server of a lower term",
       [](ExecutorRig& rig, const std::string&, const std::string& to) {
         rig.executor().AdmitTerm(2);
         rig.Level(to, kOrdered, kHeld, "", /*command_term=*/1);
       },
       End::kFrom, End::kFrom, "id-1.5 refused_stale"},
      {"a decision of a later term than the server's",
       [](ExecutorRig& rig, const std::string&, const std::string& to) {
         rig.Level(to, {7, 1}, kHeld, "odd", /*command_term=*/2);
       },
       End::kFrom, End::kFrom, "odd refused"},
      {"based on a decision that is not held",
       [](ExecutorRig& rig, const std::string&, const std::string& to) {
         rig.Level(to, kOrdered, DecisionId{1, 3}, "odd");
       },
       End::kTo, End::kFrom, "odd "},
      {"based on nothing",
       [](ExecutorRig& rig, const std::string&, const std::string& to) {
         rig.Level(to, kOrdered, {}, "odd");
       },
       End::kTo, End::kFrom, "odd "},
      {"a level of another bundle",
       [](ExecutorRig& rig, const std::string&, const std::string&) {
         rig.Level("PANIC", kOrdered, kHeld, "odd");
       },
       End::kFrom, End::kFrom, "odd refused"},
  };
}

TEST(LevelControllerMatrixTest, EveryPairOfLevelsUnderEveryFaultOfCommands) {
  const std::vector<std::string> levels = ExecutorRig::Options().levels;
  std::string table = absl::StrFormat("%-44s", "where the robot ends");
  for (size_t from = 0; from < levels.size(); ++from) {
    for (size_t to = 0; to < levels.size(); ++to) {
      if (from != to) absl::StrAppendFormat(&table, "%c>%c ", levels[from][0], levels[to][0]);
    }
  }
  for (const Fault& fault : Faults()) {
    absl::StrAppendFormat(&table, "\n%-44s", fault.name);
    for (size_t from = 0; from < levels.size(); ++from) {
      for (size_t to = 0; to < levels.size(); ++to) {
        if (from == to) continue;
        SCOPED_TRACE(absl::StrCat(fault.name, ", ", levels[from], " to ", levels[to]));
        ExecutorRig rig(ExecutorRig::At(levels[from], kHeld));
        rig.lease = true;
        rig.Advance(500);
        rig.PopReceipts();

        fault.play(rig, levels[from], levels[to]);
        rig.Advance(1'000);

        const Fault::End end = to > from ? fault.raise : fault.lowering;
        const std::string& wanted = end == Fault::End::kTo ? levels[to] : levels[from];
        const ExecutorReport report = rig.report();
        EXPECT_EQ(report.decided, wanted);
        EXPECT_EQ(report.effective, wanted);
        EXPECT_TRUE(report.verified);
        EXPECT_THAT(rig.PopReceipts(), Contains(testing::StartsWith(fault.receipt)));
        EXPECT_EQ(rig.Restarted().report().effective, wanted) << "after a restart";
        absl::StrAppendFormat(&table, " %c  ", report.effective[0]);
      }
    }
  }
  std::cout << table << "\n";
}

}  // namespace
}  // namespace rips::actuator
