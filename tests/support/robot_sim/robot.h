// The simulated robot: drivers (camera, lidar), base, navigator and mode manager, each part a
// lifecycle node whose publisher is silent while it is inactive.
//
//   /camera     publishes /camera/image_raw  at `frame_rate` (sensor-data QoS)
//   /lidar      publishes /scan              at `scan_rate` (sensor-data QoS)
//   /navigator  publishes /cmd_vel           10 Hz, at 80 % of `max_speed`
//   /base       publishes /odom              20 Hz; obeys /cmd_vel up to `max_speed`
//   /ekf_filter_node  publishes /odometry/filtered  at `frequency`: the same, of any base
//   /global_costmap  publishes /global_costmap/costmap  at `publish_frequency`, with the keep-out
//                    zone if `keepout_filter.enabled`
//
// With a floor the robot drives where it is sent (patrol.h), and it has a costmap.
//
// The System Modes file says which parts there are; a part of another name gets no topics.
#ifndef RIPS_TESTS_SUPPORT_ROBOT_SIM_ROBOT_H_
#define RIPS_TESTS_SUPPORT_ROBOT_SIM_ROBOT_H_

#include <atomic>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/container/btree_map.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "services/base/clock.h"
#include "services/dds/participant.h"
#include "services/dds/raw_writer.h"
#include "services/ros2/discovery_info.h"
#include "services/runtime/mutex.h"
#include "tests/support/robot_sim/floor.h"
#include "tests/support/robot_sim/mode_machine.h"
#include "tests/support/robot_sim/patrol.h"
#include "tests/support/robot_sim/ros_messages.h"
#include "tests/support/robot_sim/ros_process.h"
#include "tests/support/robot_sim/scaled_clock.h"
#include "tests/support/robot_sim/stop_flag.h"

namespace rips::robot_sim {

struct RobotOptions {
  std::string manager_node = "/safety";
  // Parts that run in this robot; empty = all. The others may run in another.
  std::vector<std::string> only;
  ManagerConduct conduct = ManagerConduct::kHonest;
  // How long the manager takes to answer change_mode; the transition starts with the request.
  absl::Duration answer_delay = absl::ZeroDuration();
  ros2::GidBytes gid_bytes = ros2::GidBytes::k24;
  // With DDS Security: each process has the enclave of its name and, since the middleware holds the
  // permissions of one enclave for each domain, a domain of its own that looks like the others
  // from outside (CYCLONEDDS_URI has an ExternalDomainId). Empty = without.
  std::string keystore;
  // Of the camera.
  ImageSize image;
  // Where it drives; without it, straight ahead.
  std::optional<FloorPlan> floor;
  // Its time runs so many times as fast as the host's.
  double speed = 1;
};

// Step from one thread; services and subscriptions run on their own.
class Robot {
 public:
  // `domain` is not used with a keystore.
  static absl::StatusOr<std::unique_ptr<Robot>> Create(std::shared_ptr<const dds::Domain> domain,
                                                       ModeMachine machine,
                                                       const RobotOptions& options);
  ~Robot() { closing_.Stop(); }

  // Publishes what is due now and switches modes that are due. Call every few milliseconds. True if
  // the system's mode is another than at the last call.
  bool Step() ABSL_LOCKS_EXCLUDED(mu_);

  // The system's mode by what its parts do; "" if none fits.
  std::string Mode() const ABSL_LOCKS_EXCLUDED(mu_);
  // What a test does to the robot or wants to know of it.
  template <typename Change>
  auto With(Change change) ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    return change(machine_);
  }
  // The camera sees nothing but black, or what it saw before.
  void CoverLens(bool covered) { lens_covered_ = covered; }
  // Sends it to a place of its floor. FailedPrecondition without one.
  absl::Status Send(const std::string& place) ABSL_LOCKS_EXCLUDED(mu_);
  absl::Status SendPerson() ABSL_LOCKS_EXCLUDED(mu_);
  // The mode manager's process ends; one of the same name starts, which knows nothing. From the
  // thread of Step.
  void StopManager() ABSL_LOCKS_EXCLUDED(mu_);
  absl::Status StartManager() ABSL_LOCKS_EXCLUDED(mu_);
  // Orders that came to the manager and to the nodes themselves, of all parts.
  int orders() const { return orders_; }
  int direct_orders() const { return direct_orders_; }
  std::vector<std::string> NodeNames() const;
  // Of its processes, the manager's included.
  std::vector<ros2::Guid> Participants() const;

 private:
  struct TopicSpec;
  // A publisher that speaks at a steady rate while its node is active.
  struct Beat {
    const TopicSpec* spec = nullptr;
    dds::RawWriter* writer = nullptr;
    int64_t next_ns = 0;  // boot time; 0 = at once
  };
  struct PartWriters {
    dds::RawWriter* log = nullptr;
    dds::RawWriter* parameter_events = nullptr;
    dds::RawWriter* transition_event = nullptr;
  };
  struct Outgoing {
    dds::RawWriter* writer = nullptr;
    std::string payload;
  };

  Robot(std::shared_ptr<const dds::Domain> domain, ModeMachine machine,
        const RobotOptions& options);

  absl::Status AddPart(RosProcess& process, const std::string& name);
  absl::Status AddLifecycle(RosNode& node);
  absl::Status AddTopics(RosNode& node);
  absl::Status AddManager(RosProcess& process);
  absl::Status AddModeTopics(RosNode& manager, const std::string& part);
  absl::Status AddModeServices(RosNode& manager, const std::string& part);
  absl::Status AddSystemState(RosNode& manager);

  // Threads of the services.
  bool OrderMode(const std::string& part, const std::string& mode) ABSL_LOCKS_EXCLUDED(mu_);
  void OnTwist(absl::string_view payload) ABSL_LOCKS_EXCLUDED(mu_);

  // The next message of a topic.
  std::string Encode(const TopicSpec& spec, const NodeState& node, const Instant& now)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  Twist NextTwist(const NodeState& navigator, const Instant& now)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // How the base moves now.
  Twist Obeyed(const Instant& now) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  bool KeepsOut() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  std::string NextOdometry(const Instant& now) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void CollectBeats(const Instant& now, std::vector<Outgoing>& out)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void CollectChanges(const Instant& now, std::vector<Outgoing>& out)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);

  const std::shared_ptr<const dds::Domain> domain_;
  const RobotOptions options_;
  const ScaledClock clock_;
  std::atomic<int> orders_ = 0;
  std::atomic<bool> lens_covered_ = false;
  std::atomic<int> direct_orders_ = 0;
  StopFlag closing_;
  mutable Mutex mu_;
  ModeMachine machine_ ABSL_GUARDED_BY(mu_);
  // What was told to the others last.
  absl::btree_map<std::string, NodeState> told_nodes_ ABSL_GUARDED_BY(mu_);
  std::string told_mode_ ABSL_GUARDED_BY(mu_);
  Twist commanded_ ABSL_GUARDED_BY(mu_);
  int64_t commanded_unix_ns_ ABSL_GUARDED_BY(mu_) = 0;
  double travelled_ ABSL_GUARDED_BY(mu_) = 0;  // metres, without a floor
  std::optional<Patrol> patrol_ ABSL_GUARDED_BY(mu_);
  uint32_t frames_ ABSL_GUARDED_BY(mu_) = 0;

  std::vector<Beat> beats_;
  absl::btree_map<std::string, PartWriters> part_writers_;
  // By part; of the manager.
  absl::btree_map<std::string, dds::RawWriter*> mode_events_;
  absl::btree_map<std::string, dds::RawWriter*> mode_requests_;
  // Last: their threads use what is above.
  std::vector<std::unique_ptr<RosProcess>> processes_;
  std::unique_ptr<RosProcess> manager_;  // null if there is none, or it lives with a part
};

}  // namespace rips::robot_sim

#endif  // RIPS_TESTS_SUPPORT_ROBOT_SIM_ROBOT_H_
