#include "tests/support/robot_sim/robot.h"

#include <algorithm>
#include <optional>
#include <utility>
#include <variant>

#include "absl/algorithm/container.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/strip.h"
#include "services/base/status_macros.h"
#include "tests/support/robot_sim/commands.h"
#include "tests/support/ros2/server_messages.h"

namespace rips::robot_sim {

// One publisher of one part.
struct Robot::TopicSpec {
  enum class Content { kImage, kScan, kTwist, kOdometry, kCostmap };
  Content content;
  absl::string_view node;
  absl::string_view topic;
  absl::string_view type;
  bool sensor_data;  // else reliable
  // The parameter with the rate in Hz; `hz` where the node has none.
  absl::string_view rate_parameter;
  double hz;
};

namespace {

// Numbers of domains beyond are those of secured processes within this one.
constexpr uint32_t kSecuredDomain = 110;
constexpr absl::string_view kTwistType = "geometry_msgs/msg/Twist";
constexpr absl::string_view kTransitionEventType = "lifecycle_msgs/msg/TransitionEvent";
constexpr absl::string_view kModeEventType = "system_modes_msgs/msg/ModeEvent";
// A base that hears no command for so long stands still.
constexpr int64_t kCommandTimeoutNs = 500 * kNanosPerMilli;
// Part of `max_speed` the navigator asks for.
constexpr double kCruise = 0.8;
constexpr double kOdometryHz = 20;
// How late a busy host may wake a thread.
constexpr double kHostLatenessNs = 50.0 * kNanosPerMilli;
constexpr char kCostmapNode[] = "/global_costmap";

// lifecycle_msgs/msg/State before, during and after a change.
ros2::LifecycleLabel Settled(bool active) {
  return active ? ros2::LifecycleLabel{3, "active"} : ros2::LifecycleLabel{2, "inactive"};
}
ros2::LifecycleLabel Changing(bool to_active) {
  return to_active ? ros2::LifecycleLabel{13, "activating"}
                   : ros2::LifecycleLabel{14, "deactivating"};
}

double NumberOr(const NodeState& node, absl::string_view parameter, double fallback) {
  const auto it = node.parameters.find(parameter);
  const double* value = it == node.parameters.end() ? nullptr : std::get_if<double>(&it->second);
  return value == nullptr || *value <= 0 ? fallback : *value;
}

actuator::ParameterMap Changed(const actuator::ParameterMap& from,
                               const actuator::ParameterMap& to) {
  actuator::ParameterMap changed;
  for (const auto& [name, value] : to) {
    if (const auto it = from.find(name); it == from.end() || it->second != value) {
      changed.emplace(name, value);
    }
  }
  return changed;
}

// The process a part lives in: the two drivers share one, as composed nodes do.
absl::string_view ProcessOf(absl::string_view part) {
  return part == "/camera" || part == "/lidar" ? "drivers" : part;
}

// `number` is its own; 1 or more.
absl::StatusOr<std::unique_ptr<RosProcess>> MakeProcess(std::shared_ptr<const dds::Domain> domain,
                                                        absl::string_view name,
                                                        const RobotOptions& options,
                                                        size_t number) {
  if (options.keystore.empty()) return RosProcess::Create(std::move(domain), options.gid_bytes);
  const std::string enclave = absl::StrCat("/", absl::StripPrefix(name, "/"));
  RIPS_ASSIGN_OR_RETURN(const dds::ParticipantOptions identity,
                        Identity({.keystore = options.keystore, .enclave = enclave}));
  const uint32_t id = kSecuredDomain + static_cast<uint32_t>(number);
  RIPS_ASSIGN_OR_RETURN(std::shared_ptr<const dds::Domain> own, dds::Domain::Create({.id = id}));
  return RosProcess::Create(std::move(own), options.gid_bytes, identity);
}

}  // namespace

Robot::Robot(std::shared_ptr<const dds::Domain> domain, ModeMachine machine,
             const RobotOptions& options)
    : domain_(std::move(domain)),
      options_(options),
      clock_(options.speed),
      machine_(std::move(machine)) {
  if (options.floor) patrol_.emplace(Floor(*options.floor));
  told_nodes_ = machine_.nodes();
  told_mode_ = machine_.TrueMode();
}

absl::StatusOr<std::unique_ptr<Robot>> Robot::Create(std::shared_ptr<const dds::Domain> domain,
                                                     ModeMachine machine,
                                                     const RobotOptions& options) {
  const absl::btree_map<std::string, NodeState> parts = machine.nodes();
  std::unique_ptr<Robot> robot(new Robot(domain, std::move(machine), options));
  absl::btree_map<std::string, RosProcess*> by_name;
  const auto process_named = [&](absl::string_view name) -> absl::StatusOr<RosProcess*> {
    RosProcess*& process = by_name[std::string(name)];
    if (process == nullptr) {
      RIPS_ASSIGN_OR_RETURN(std::unique_ptr<RosProcess> created,
                            MakeProcess(domain, name, options, by_name.size()));
      process = created.get();
      robot->processes_.push_back(std::move(created));
    }
    return process;
  };
  for (const auto& [name, unused] : parts) {
    if (!options.only.empty() && !absl::c_linear_search(options.only, name)) continue;
    RIPS_ASSIGN_OR_RETURN(RosProcess * process, process_named(ProcessOf(name)));
    RIPS_RETURN_IF_ERROR(robot->AddPart(*process, name));
  }
  if (options.conduct != ManagerConduct::kAbsent) {
    RIPS_RETURN_IF_ERROR(robot->StartManager());
  }
  for (const std::unique_ptr<RosProcess>& process : robot->processes_) {
    RIPS_RETURN_IF_ERROR(process->Announce());
  }
  return robot;
}

void Robot::StopManager() {
  {
    MutexLock lock(&mu_);
    mode_events_.clear();
    machine_.ForgetModes();
  }
  manager_.reset();
  mode_requests_.clear();
}

absl::Status Robot::StartManager() {
  RIPS_ASSIGN_OR_RETURN(
      manager_, MakeProcess(domain_, options_.manager_node, options_, processes_.size() + 1));
  RIPS_RETURN_IF_ERROR(AddManager(*manager_));
  return manager_->Announce();
}

absl::Status Robot::AddPart(RosProcess& process, const std::string& name) {
  const auto parameters = [this, name] {
    MutexLock lock(&mu_);
    return machine_.nodes().at(name).parameters;
  };
  const auto set = [this, name](const actuator::ParameterMap& wanted) {
    ++direct_orders_;
    MutexLock lock(&mu_);
    return machine_.SetParameters(name, wanted);
  };
  RIPS_ASSIGN_OR_RETURN(RosNode * node, process.AddNode(name, parameters, set));
  part_writers_[name] = {.log = node->log(), .parameter_events = node->parameter_events()};
  RIPS_RETURN_IF_ERROR(AddLifecycle(*node));
  return AddTopics(*node);
}

absl::Status Robot::AddLifecycle(RosNode& node) {
  const std::string name = node.full_name();
  RIPS_ASSIGN_OR_RETURN(
      part_writers_[name].transition_event,
      node.Publish(absl::StrCat(name, "/transition_event"), kTransitionEventType, DefaultQos()));
  RIPS_RETURN_IF_ERROR(
      node.Serve(absl::StrCat(name, "/change_state"), ros2::kChangeStateType,
                 [this, name](absl::string_view request) -> std::optional<std::string> {
                   const auto transition = ros2::DecodeChangeStateRequest(request);
                   if (!transition.ok()) {
                     return std::nullopt;
                   }
                   ++direct_orders_;
                   MutexLock lock(&mu_);
                   return ros2::EncodeSuccessReply(machine_.ChangeState(name, transition->id));
                 }));
  RIPS_RETURN_IF_ERROR(node.Serve(
      absl::StrCat(name, "/get_state"), ros2::kGetStateType, [this, name](absl::string_view) {
        MutexLock lock(&mu_);
        const Lifecycle state = machine_.State(name);
        return ros2::EncodeGetStateReply({static_cast<uint8_t>(state), std::string(Label(state))});
      }));
  RIPS_RETURN_IF_ERROR(node.Serve(absl::StrCat(name, "/get_available_states"),
                                  "lifecycle_msgs/srv/GetAvailableStates"));
  for (const absl::string_view service : {"/get_available_transitions", "/get_transition_graph"}) {
    RIPS_RETURN_IF_ERROR(
        node.Serve(absl::StrCat(name, service), "lifecycle_msgs/srv/GetAvailableTransitions"));
  }
  return absl::OkStatus();
}

absl::Status Robot::AddTopics(RosNode& node) {
  using Content = TopicSpec::Content;
  static constexpr TopicSpec kTopics[] = {
      {Content::kImage, "/camera", "/camera/image_raw", "sensor_msgs/msg/Image", true, "frame_rate",
       15},
      {Content::kScan, "/lidar", "/scan", "sensor_msgs/msg/LaserScan", true, "scan_rate", 10},
      {Content::kTwist, "/navigator", "/cmd_vel", kTwistType, false, "", 10},
      {Content::kOdometry, "/base", "/odom", "nav_msgs/msg/Odometry", false, "", kOdometryHz},
      {Content::kOdometry, "/ekf_filter_node", "/odometry/filtered", "nav_msgs/msg/Odometry", false,
       "frequency", kOdometryHz},
      {Content::kCostmap, kCostmapNode, "/global_costmap/costmap", "nav_msgs/msg/OccupancyGrid",
       false, "publish_frequency", 2},
  };
  for (const TopicSpec& spec : kTopics) {
    if (spec.node != node.full_name()) {
      continue;
    }
    RIPS_ASSIGN_OR_RETURN(
        dds::RawWriter * writer,
        node.Publish(spec.topic, spec.type, spec.sensor_data ? SensorDataQos() : DefaultQos()));
    beats_.push_back({.spec = &spec, .writer = writer});
  }
  if (node.full_name() == "/base") {
    return node.Subscribe("/cmd_vel", kTwistType, DefaultQos(),
                          [this](const dds::RawSample& sample) { OnTwist(sample.payload); });
  }
  return absl::OkStatus();
}

absl::Status Robot::AddManager(RosProcess& process) {
  RIPS_ASSIGN_OR_RETURN(RosNode * manager, process.AddNode(options_.manager_node));
  std::vector<std::string> parts;
  {
    MutexLock lock(&mu_);
    parts.push_back(machine_.system());
    for (const auto& [name, unused] : machine_.nodes()) {
      parts.push_back(name);
    }
  }
  RIPS_RETURN_IF_ERROR(
      manager->Subscribe("/parameter_events", "rcl_interfaces/msg/ParameterEvent", DefaultQos()));
  // All publishers before any service: a request may come as soon as its service is there.
  for (const std::string& part : parts) {
    RIPS_RETURN_IF_ERROR(AddModeTopics(*manager, part));
  }
  for (const std::string& part : parts) {
    RIPS_RETURN_IF_ERROR(AddModeServices(*manager, part));
  }
  return AddSystemState(*manager);
}

absl::Status Robot::AddModeTopics(RosNode& manager, const std::string& part) {
  const ros2::Qos qos = DefaultQos(1);
  RIPS_ASSIGN_OR_RETURN(mode_events_[part],
                        manager.Publish(absl::StrCat(part, "/mode_event"), kModeEventType, qos));
  RIPS_ASSIGN_OR_RETURN(
      mode_requests_[part],
      manager.Publish(absl::StrCat(part, "/mode_request_info"), kModeEventType, qos));
  return manager.Publish(absl::StrCat(part, "/transition_request_info"), kTransitionEventType, qos)
      .status();
}

absl::Status Robot::AddModeServices(RosNode& manager, const std::string& part) {
  RIPS_RETURN_IF_ERROR(
      manager.Serve(absl::StrCat(part, "/change_mode"), ros2::kChangeModeType,
                    [this, part](absl::string_view request) -> std::optional<std::string> {
                      const auto mode = ros2::DecodeChangeModeRequest(request);
                      if (!mode.ok()) {
                        return std::nullopt;
                      }
                      return ros2::EncodeSuccessReply(OrderMode(part, *mode));
                    }));
  RIPS_RETURN_IF_ERROR(manager.Serve(absl::StrCat(part, "/get_mode"), ros2::kGetModeType,
                                     [this, part](absl::string_view) {
                                       MutexLock lock(&mu_);
                                       return ros2::EncodeGetModeReply(machine_.Mode(part));
                                     }));
  return manager.Serve(absl::StrCat(part, "/get_available_modes"), ros2::kGetAvailableModesType,
                       [this, part](absl::string_view) {
                         MutexLock lock(&mu_);
                         return ros2::EncodeGetAvailableModesReply(machine_.AvailableModes(part));
                       });
}

absl::Status Robot::AddSystemState(RosNode& manager) {
  std::string system;
  {
    MutexLock lock(&mu_);
    system = machine_.system();
  }
  RIPS_RETURN_IF_ERROR(manager.Serve(
      absl::StrCat(system, "/get_state"), ros2::kGetStateType, [this, system](absl::string_view) {
        MutexLock lock(&mu_);
        const Lifecycle state = machine_.State(system);
        return ros2::EncodeGetStateReply({static_cast<uint8_t>(state), std::string(Label(state))});
      }));
  // Activating a system is the same as ordering its default mode.
  RIPS_RETURN_IF_ERROR(manager.Serve(
      absl::StrCat(system, "/change_state"), ros2::kChangeStateType,
      [this, system](absl::string_view request) -> std::optional<std::string> {
        const auto transition = ros2::DecodeChangeStateRequest(request);
        if (!transition.ok()) {
          return std::nullopt;
        }
        return ros2::EncodeSuccessReply(transition->id == kTransitionActivate &&
                                        OrderMode(system, std::string(actuator::kDefaultMode)));
      }));
  RIPS_RETURN_IF_ERROR(manager.Serve(absl::StrCat(system, "/get_available_states"),
                                     "lifecycle_msgs/srv/GetAvailableStates"));
  return manager
      .Publish(absl::StrCat(system, "/transition_event"), kTransitionEventType, DefaultQos(1))
      .status();
}

bool Robot::OrderMode(const std::string& part, const std::string& mode) {
  ++orders_;
  bool accepted = false;
  {
    MutexLock lock(&mu_);
    accepted = machine_.ChangeMode(part, mode, clock_.Now().boottime_ns);
  }
  if (accepted) {
    // Nobody relies on it.
    mode_requests_.at(part)->Write(EncodeModeEvent("", mode)).IgnoreError();
  }
  closing_.WaitFor(options_.answer_delay);
  return accepted;
}

void Robot::OnTwist(absl::string_view payload) {
  const absl::StatusOr<Twist> twist = DecodeTwist(payload);
  if (!twist.ok()) {
    return;
  }
  const int64_t unix_ns = clock_.Now().unix_ns;
  MutexLock lock(&mu_);
  commanded_ = *twist;
  commanded_unix_ns_ = unix_ns;
}

bool Robot::Step() {
  std::vector<Outgoing> out;
  bool another_mode = false;
  {
    MutexLock lock(&mu_);
    const Instant now = clock_.Now();
    machine_.Advance(now.boottime_ns);
    if (patrol_) patrol_->Drive(now.boottime_ns, Obeyed(now));
    const std::string before = told_mode_;
    CollectChanges(now, out);
    another_mode = told_mode_ != before;
    CollectBeats(now, out);
  }
  for (const Outgoing& message : out) {
    // A lost message of a robot is no reason for the robot to stop.
    message.writer->Write(message.payload).IgnoreError();
  }
  return another_mode;
}

std::string Robot::Encode(const TopicSpec& spec, const NodeState& node, const Instant& now) {
  constexpr double kScanMetres = 4;
  switch (spec.content) {
    case TopicSpec::Content::kImage:
      return EncodeImage(now.unix_ns, frames_++, options_.image, lens_covered_);
    case TopicSpec::Content::kScan:
      return EncodeLaserScan(now.unix_ns, kScanMetres);
    case TopicSpec::Content::kTwist:
      return EncodeTwist(NextTwist(node, now));
    case TopicSpec::Content::kOdometry:
      return NextOdometry(now);
    case TopicSpec::Content::kCostmap: {
      if (!patrol_) return EncodeOccupancyGrid(now.unix_ns, 0, 0, 1, "");
      const FloorPlan& plan = patrol_->floor().plan();
      return EncodeOccupancyGrid(now.unix_ns, static_cast<uint32_t>(plan.width),
                                 static_cast<uint32_t>(plan.height), plan.cell_m,
                                 patrol_->Grid(now.boottime_ns, KeepsOut()));
    }
  }
  return "";
}

bool Robot::KeepsOut() const {
  const auto costmap = machine_.nodes().find(kCostmapNode);
  if (costmap == machine_.nodes().end()) return false;
  const auto enabled = costmap->second.parameters.find("keepout_filter.enabled");
  if (enabled == costmap->second.parameters.end()) return false;
  const bool* on = std::get_if<bool>(&enabled->second);
  return on != nullptr && *on;
}

Twist Robot::NextTwist(const NodeState& navigator, const Instant& now) {
  const double max_speed = NumberOr(navigator, "max_speed", 0);
  if (!patrol_) return {.linear_x = kCruise * max_speed};
  return patrol_->Steer(now.boottime_ns, KeepsOut(), max_speed);
}

Twist Robot::Obeyed(const Instant& now) const {
  const auto base = machine_.nodes().find("/base");
  if (base == machine_.nodes().end() || !base->second.active) return {};
  if (now.unix_ns - commanded_unix_ns_ > kCommandTimeoutNs) return {};
  const double limit = NumberOr(base->second, "max_speed", 0);
  return {.linear_x = std::clamp(commanded_.linear_x, -limit, limit),
          .linear_y = std::clamp(commanded_.linear_y, -limit, limit)};
}

std::string Robot::NextOdometry(const Instant& now) {
  const Twist speed = Obeyed(now);
  Odometry odometry{.x = 0, .speed_x = speed.linear_x, .speed_y = speed.linear_y};
  if (patrol_) {
    odometry.x = patrol_->at().x;
    odometry.y = patrol_->at().y;
  } else {
    travelled_ += speed.linear_x / kOdometryHz;
    odometry.x = travelled_;
  }
  return EncodeOdometry(now.unix_ns, odometry);
}

absl::Status Robot::Send(const std::string& place) {
  MutexLock lock(&mu_);
  if (!patrol_) return absl::FailedPreconditionError("the robot has no floor");
  return patrol_->Send(place);
}

absl::Status Robot::SendPerson() {
  MutexLock lock(&mu_);
  if (!patrol_) return absl::FailedPreconditionError("the robot has no floor");
  patrol_->SendPerson(clock_.Now().boottime_ns);
  return absl::OkStatus();
}

void Robot::CollectBeats(const Instant& now, std::vector<Outgoing>& out) {
  for (Beat& beat : beats_) {
    const NodeState& node = machine_.nodes().find(beat.spec->node)->second;
    if (!node.active && !node.goes_on) {
      beat.next_ns = 0;
      continue;
    }
    if (now.boottime_ns < beat.next_ns) {
      continue;
    }
    const double hz = NumberOr(node, beat.spec->rate_parameter, beat.spec->hz);
    const auto period_ns = static_cast<int64_t>(static_cast<double>(kNanosPerSecond) / hz);
    // One that is a whole period late skips what it missed; in a robot that runs faster than its
    // host can keep time, not at once.
    const auto late_ns = static_cast<int64_t>((options_.speed - 1) * kHostLatenessNs);
    const bool in_step = beat.next_ns > now.boottime_ns - std::max(period_ns, late_ns);
    beat.next_ns = (in_step ? beat.next_ns : now.boottime_ns) + period_ns;
    out.push_back({beat.writer, Encode(*beat.spec, node, now)});
  }
}

void Robot::CollectChanges(const Instant& now, std::vector<Outgoing>& out) {
  for (const auto& [name, node] : machine_.nodes()) {
    NodeState& told = told_nodes_[name];
    const auto own = part_writers_.find(name);
    if (own == part_writers_.end()) continue;
    const PartWriters& writers = own->second;
    if (told.active != node.active) {
      const ros2::LifecycleLabel via = Changing(node.active);
      out.push_back({writers.transition_event, EncodeTransitionEvent(Settled(told.active), via)});
      out.push_back({writers.transition_event, EncodeTransitionEvent(via, Settled(node.active))});
      out.push_back({writers.log, EncodeLog(now.unix_ns, name.substr(1),
                                            node.active ? "activated" : "deactivated")});
    }
    if (told.parameters != node.parameters) {
      out.push_back(
          {writers.parameter_events,
           EncodeParameterEvent(now.unix_ns, name, {}, Changed(told.parameters, node.parameters))});
    }
    if (const auto event = mode_events_.find(name);
        event != mode_events_.end() && told.mode != node.mode) {
      out.push_back({event->second, EncodeModeEvent(told.mode, node.mode)});
    }
    told = node;
  }
  const std::string mode = machine_.TrueMode();
  if (const auto event = mode_events_.find(machine_.system());
      event != mode_events_.end() && mode != told_mode_) {
    out.push_back({event->second, EncodeModeEvent(told_mode_, mode)});
  }
  told_mode_ = mode;
}

std::string Robot::Mode() const {
  MutexLock lock(&mu_);
  return machine_.TrueMode();
}

std::vector<ros2::Guid> Robot::Participants() const {
  std::vector<ros2::Guid> guids;
  for (const std::unique_ptr<RosProcess>& process : processes_) {
    guids.push_back(process->participant().guid());
  }
  if (manager_ != nullptr) guids.push_back(manager_->participant().guid());
  return guids;
}

std::vector<std::string> Robot::NodeNames() const {
  std::vector<std::string> names;
  for (const std::unique_ptr<RosProcess>& process : processes_) {
    for (const std::unique_ptr<RosNode>& node : process->nodes()) {
      names.push_back(node->full_name());
    }
  }
  if (manager_ != nullptr) names.push_back(options_.manager_node);
  std::sort(names.begin(), names.end());
  return names;
}

}  // namespace rips::robot_sim
