#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <fstream>
#include <memory>
#include <optional>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "nlohmann/json.hpp"
#include "services/base/status_macros.h"
#include "services/dds/raw_writer.h"
#include "services/dds/security.h"
#include "services/ros2/ros_name.h"
#include "services/runtime/log.h"
#include "services/runtime/real_clock.h"
#include "tests/support/robot_sim/bad_discovery.h"
#include "tests/support/robot_sim/commands.h"
#include "tests/support/robot_sim/control.h"
#include "tests/support/robot_sim/events.h"
#include "tests/support/robot_sim/floor.h"
#include "tests/support/robot_sim/robot.h"

namespace rips::robot_sim {
namespace {

// Of the robot's time, but not shorter than a thread can sleep.
constexpr absl::Duration kStep = absl::Milliseconds(4);
constexpr absl::Duration kStepMin = absl::Microseconds(500);
constexpr int64_t kBadDiscoveryPeriodNs = 100 * kNanosPerMilli;

// A participant that sends nonsense on `ros_discovery_info`, one message after the other.
class BadDiscoverySender {
 public:
  static absl::StatusOr<std::unique_ptr<BadDiscoverySender>> Create(
      std::shared_ptr<const dds::Domain> domain) {
    std::unique_ptr<BadDiscoverySender> sender(new BadDiscoverySender);
    RIPS_ASSIGN_OR_RETURN(sender->participant_, dds::Participant::Create(std::move(domain)));
    RIPS_ASSIGN_OR_RETURN(
        sender->writer_,
        dds::RawWriter::Create(*sender->participant_,
                               {.topic = ros2::kDiscoveryTopic,
                                .type = ros2::kDiscoveryType,
                                .qos = {.reliable = true, .transient_local = true, .depth = 1}}));
    sender->messages_ = BadDiscoveryMessages(sender->participant_->guid());
    return sender;
  }

  absl::Status Step(const Instant& now) {
    if (now.boottime_ns < next_ns_) {
      return absl::OkStatus();
    }
    next_ns_ = now.boottime_ns + kBadDiscoveryPeriodNs;
    RIPS_RETURN_IF_ERROR(writer_->Write(messages_[sent_ % messages_.size()].payload));
    if (++sent_ == messages_.size()) {
      PrintEvent({{"event", "bad_discovery"}, {"sent", sent_}, {"unix_ns", now.unix_ns}});
    }
    return absl::OkStatus();
  }

 private:
  BadDiscoverySender() = default;

  std::unique_ptr<dds::Participant> participant_;
  std::unique_ptr<dds::RawWriter> writer_;
  std::vector<BadDiscoveryMessage> messages_;
  size_t sent_ = 0;
  int64_t next_ns_ = 0;
};

// Whatever its number within this process, a domain has this one outside.
absl::Status SetOuterDomain(const dds::DomainOptions& domain) {
  const char* set = std::getenv("CYCLONEDDS_URI");
  std::string uri = set == nullptr ? "" : set;
  if (uri.empty()) {
    RIPS_ASSIGN_OR_RETURN(uri, dds::DomainXml(domain, 0));
  }
  absl::StrAppend(&uri, ",<CycloneDDS><Domain><Discovery><ExternalDomainId>", domain.id,
                  "</ExternalDomainId></Discovery></Domain></CycloneDDS>");
  setenv("CYCLONEDDS_URI", uri.c_str(), 1);
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<dds::ParticipantOptions> Identity(const DdsSettings& security) {
  RIPS_ASSIGN_OR_RETURN(std::optional<dds::Enclave> enclave,
                        dds::LoadSecurity(security, absl::Now()));
  return dds::ParticipantOptions{.security = std::move(enclave)};
}

absl::StatusOr<std::string> ReadFile(const std::string& path) {
  const std::ifstream in(path, std::ios::binary);
  if (!in) {
    return absl::NotFoundError(absl::StrCat("cannot read `", path, "`"));
  }
  std::ostringstream text;
  text << in.rdbuf();
  return text.str();
}

absl::Status RunRobot(const RobotCommand& command, StopFlag& stop) {
  RIPS_ASSIGN_OR_RETURN(const std::string text, ReadFile(command.smh_file));
  RIPS_ASSIGN_OR_RETURN(actuator::Smh smh, actuator::ParseSmh(text, command.smh_file));
  for (const std::string& warning : smh.warnings) {
    LogWarning("system modes file", {{"warning", warning}});
  }
  RIPS_ASSIGN_OR_RETURN(
      ModeMachine machine,
      ModeMachine::Create(std::move(smh),
                          {.system = command.system,
                           .transition_ns = absl::ToInt64Nanoseconds(command.transition),
                           .conduct = command.conduct}));
  std::optional<FloorPlan> floor;
  if (!command.floor_file.empty()) {
    RIPS_ASSIGN_OR_RETURN(const std::string plan, ReadFile(command.floor_file));
    RIPS_ASSIGN_OR_RETURN(floor, ParseFloorPlan(plan, command.floor_file));
  }
  std::shared_ptr<const dds::Domain> domain;
  if (command.keystore.empty()) {
    RIPS_ASSIGN_OR_RETURN(domain, dds::Domain::Create(command.domain));
  } else {
    RIPS_RETURN_IF_ERROR(SetOuterDomain(command.domain));
  }
  RIPS_ASSIGN_OR_RETURN(std::unique_ptr<Robot> robot,
                        Robot::Create(domain, std::move(machine),
                                      {.manager_node = command.manager_node,
                                       .only = command.only,
                                       .conduct = command.conduct,
                                       .answer_delay = command.answer_delay,
                                       .gid_bytes = command.gid_bytes,
                                       .keystore = command.keystore,
                                       .image = command.image,
                                       .floor = floor,
                                       .speed = command.speed}));
  std::unique_ptr<BadDiscoverySender> bad;
  if (command.bad_discovery) {
    RIPS_ASSIGN_OR_RETURN(bad, BadDiscoverySender::Create(domain));
  }
  std::unique_ptr<Control> control;
  if (!command.control.empty()) {
    RIPS_ASSIGN_OR_RETURN(control, Control::Create(command.control));
  }
  const RealClock clock;
  PrintEvent({{"event", "ready"},
              {"mode", robot->Mode()},
              {"nodes", robot->NodeNames()},
              {"unix_ns", clock.Now().unix_ns}});
  while (!stop.WaitFor(std::max(kStepMin, kStep / command.speed))) {
    const Instant now = clock.Now();
    if (robot->Step()) {
      const std::string mode = robot->Mode();
      LogInfo("mode reached", {{"mode", mode}});
      PrintEvent({{"event", "mode"}, {"mode", mode}, {"unix_ns", now.unix_ns}});
    }
    if (control != nullptr) RIPS_RETURN_IF_ERROR(control->Step(*robot));
    if (bad != nullptr) {
      RIPS_RETURN_IF_ERROR(bad->Step(now));
    }
  }
  return absl::OkStatus();
}

}  // namespace rips::robot_sim
