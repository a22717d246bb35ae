#include "tests/simulation/world.h"

#include <algorithm>

#include "absl/strings/str_cat.h"
#include "tests/simulation/level_names.h"

namespace rips::simulation {

World::World(uint64_t seed, Fault fault)
    : context_(seed, fault),
      store_(&context_),
      server_(&context_, &store_),
      sensor_(&context_, &server_),
      actuator_(&context_, &server_) {
  server_.Start();
  sensor_.Start();
  actuator_.Start();
  Robot();
  Operator();
  Trouble();
}

bool World::Step() {
  context_.scheduler.Step();
  ++steps_;
  actuator_.Check();
  if (server_.up()) {
    const pipeline::RobotStatus status = server_.Status();
    context_.checker.OnServerHolds(status.decision_id, status.decided_level,
                                   context_.scheduler.now_ns());
  }
  return !violation().has_value();
}

void World::Robot() {
  Scheduler& scheduler = context_.scheduler;
  const int64_t what = scheduler.Between(0, 999);
  if (what < 80) {
    sensor_.IntruderComesOrGoes();
  } else if (sensor_.up()) {
    if (what < 450) {
      sensor_.SeeProbe();
    } else if (what < 997) {
      sensor_.SeeMessage();
    } else {
      sensor_.SeeSignal();
    }
  }
  scheduler.After(scheduler.Between(20, 500) * kMs, [this] { Robot(); });
}

void World::Operator() {
  Scheduler& scheduler = context_.scheduler;
  if (server_.up()) {
    // Sometimes it orders by what it saw the last time.
    if (!scheduler.Chance(15)) seen_ = server_.Status();
    if (scheduler.Chance(10)) {
      server_.Call(server_.life(),
                   [](pipeline::Robot& robot) { (void)robot.ResumeRules("alice", "maintenance"); });
    } else {
      Order(scheduler.Chance(70));
    }
  }
  scheduler.After(scheduler.Between(500, 7'000) * kMs, [this] { Operator(); });
}

void World::Order(bool lower) {
  Scheduler& scheduler = context_.scheduler;
  const int held = std::max(LevelIndex(seen_.decided_level), 0);
  const int to = static_cast<int>(lower ? scheduler.Between(0, held) : scheduler.Between(held, 3));
  const pipeline::LevelOrder order{.operator_name = "alice",
                                   .to = std::string(kLevels[to]),
                                   .reason = absl::StrCat("order ", ++orders_),
                                   .expected_level = seen_.decided_level,
                                   .expected_decision_id = seen_.decision_id,
                                   .accept_blind = scheduler.Chance(80),
                                   .request_id = absl::StrCat("request ", orders_),
                                   .identity = "td/alice"};
  context_.trace.Add("operator", absl::StrCat(lower ? "lowers to " : "raises to ", order.to));
  if (lower) context_.checker.OnLoweringOrdered(order.reason);
  const pipeline::LevelReply reply = [this,
                                      reason = order.reason](const pipeline::LevelAnswer& answer) {
    if (!answer.status.ok()) return;
    if (answer.needs_approval) return Approve(answer.pending_approval_id, reason);
    if (!answer.decision_id.none()) context_.checker.OnOrderAnswered(answer.decision_id);
  };
  server_.Call(server_.life(), [&](pipeline::Robot& robot) {
    lower ? robot.DeEscalate(order, reply) : robot.Raise(order, reply);
  });
}

void World::Approve(const std::string& lowering, const std::string& reason) {
  Scheduler& scheduler = context_.scheduler;
  scheduler.After(scheduler.Between(20, 2'000) * kMs, [this, lowering, reason] {
    if (!server_.up()) return;
    const bool alone = context_.scheduler.Chance(20);
    const pipeline::ApprovalOrder order{.operator_name = alone ? "alice" : "bob",
                                        .identity = alone ? "td/alice" : "td/bob",
                                        .id = lowering,
                                        .reason = alone ? "alone" : "seen",
                                        .accept_blind = context_.scheduler.Chance(80),
                                        .request_id = absl::StrCat("approval of ", reason)};
    context_.trace.Add("operator", absl::StrCat(order.operator_name, " approves ", reason));
    if (!alone) context_.checker.OnLoweringOrdered(absl::StrCat(reason, kApproved, order.reason));
    server_.Call(server_.life(), [&](pipeline::Robot& robot) {
      robot.Approve(order, [this](const pipeline::LevelAnswer& answer) {
        if (answer.status.ok()) context_.checker.OnOrderAnswered(answer.decision_id);
      });
    });
  });
}

void World::CrashServer() {
  if (!server_.up()) return;
  store_.Crash();
  server_.Crash();
  sensor_.Break(true);
  actuator_.Break(true);
  context_.scheduler.After(context_.scheduler.Between(20, 4'000) * kMs, [this] {
    if (!server_.up()) server_.Start();
  });
}

void World::Trouble() {
  Scheduler& scheduler = context_.scheduler;
  if (scheduler.Chance(15)) storm_ = !storm_;
  const int64_t what = scheduler.Between(0, 99);
  if (what < 15) {
    CrashServer();
  } else if (what < 28 && actuator_.up()) {
    actuator_.Crash();
    if (scheduler.Chance(15)) actuator_.LoseState();
    scheduler.After(scheduler.Between(20, 3'000) * kMs, [this] { actuator_.Start(); });
  } else if (what < 38 && sensor_.up()) {
    sensor_.Crash();
    scheduler.After(scheduler.Between(20, 2'000) * kMs, [this] { sensor_.Start(); });
  } else if (what < 50) {
    sensor_.Break(scheduler.Chance(20));
  } else if (what < 62) {
    actuator_.Break(scheduler.Chance(20));
  } else if (what < 68) {
    actuator_.Isolate(scheduler.Between(1'000, 12'000) * kMs);
    actuator_.Break(scheduler.Chance(50));
  } else if (what < 76) {
    store_.Hang(scheduler.Between(100, 3'000) * kMs);
  } else if (what < 84) {
    store_.set_disk(scheduler.Chance(50) ? StoreModel::Disk::kFails : StoreModel::Disk::kFull);
    scheduler.After(scheduler.Between(100, 3'000) * kMs,
                    [this] { store_.set_disk(StoreModel::Disk::kWorks); });
  } else if (what < 88) {
    actuator_.set_disk_fails(true);
    scheduler.After(scheduler.Between(100, 3'000) * kMs,
                    [this] { actuator_.set_disk_fails(false); });
  } else if (what < 94) {
    actuator_.Drift();
  } else {
    scheduler.clock().JumpUnix(scheduler.Between(-3'600, 3'600) * kNanosPerSecond);
    context_.trace.Add("clock", "jumps");
  }
  const int64_t pause_ms = storm_ ? scheduler.Between(5, 1'500) : scheduler.Between(500, 6'000);
  scheduler.After(pause_ms * kMs, [this] { Trouble(); });
}

std::optional<Finding> Search(uint64_t seed, uint64_t steps, uint64_t steps_each, Fault fault,
                              Counts* counts) {
  for (uint64_t total = 0; total < steps; ++seed) {
    World world(seed, fault);
    const uint64_t end = std::min(steps_each, steps - total);
    while (world.steps() < end) {
      ++total;
      if (world.Step()) continue;
      return Finding{.seed = seed,
                     .step = world.steps(),
                     .total = total,
                     .violation = *world.violation(),
                     .trace = world.trace()};
    }
    if (counts != nullptr) counts->Add(world.counts());
  }
  return std::nullopt;
}

}  // namespace rips::simulation
