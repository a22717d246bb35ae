// The subcommands of `robot_sim`. Each runs until it is done or `stop` is set, prints one JSON
// object per line on stdout, and logs for people on stderr. Every line has "event" and "unix_ns"
// (CLOCK_REALTIME); the rest is listed with each command.
#ifndef RIPS_TESTS_SUPPORT_ROBOT_SIM_COMMANDS_H_
#define RIPS_TESTS_SUPPORT_ROBOT_SIM_COMMANDS_H_

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "services/dds/participant.h"
#include "services/ros2/discovery_info.h"
#include "services/runtime/config_sections.h"
#include "tests/support/robot_sim/mode_machine.h"
#include "tests/support/robot_sim/ros_messages.h"
#include "tests/support/robot_sim/stop_flag.h"

namespace rips::robot_sim {

struct RobotCommand {
  dds::DomainOptions domain;
  // Each process has the enclave of its name: /drivers, /base, ..., and that of the manager's node.
  std::string keystore;
  std::string smh_file;
  std::string system = "/safety";
  // The node that serves the modes; mode_manager calls itself /__mode_manager.
  std::string manager_node = "/safety";
  // Parts that this process runs; empty = all.
  std::vector<std::string> only;
  ManagerConduct conduct = ManagerConduct::kHonest;
  absl::Duration transition = absl::Milliseconds(150);
  // How long change_mode takes to answer.
  absl::Duration answer_delay = absl::ZeroDuration();
  ros2::GidBytes gid_bytes = ros2::GidBytes::k24;
  // A further participant that sends BadDiscoveryMessages, one every 100 ms.
  bool bad_discovery = false;
  // Of the camera's pictures.
  ImageSize image;
  // A named pipe that is made, for orders to the robot (control.h); empty = none.
  std::string control;
  // Where it drives (floor.h); empty = straight ahead.
  std::string floor_file;
  // Its time runs so many times as fast: rates, transitions, the way it drives.
  double speed = 1;
};
// {"event":"ready","mode":"__DEFAULT__","nodes":[...]}
// {"event":"mode","mode":"ALERT"}     when the mode is reached ("" = none fits)
// {"event":"bad_discovery","sent":9}  when each message was sent once
// {"event":"control","line":"..."}    what was ordered through `control` is done
absl::Status RunRobot(const RobotCommand& command, StopFlag& stop);

enum class IntruderKind {
  kUnknownNode,  // subscribes to /camera/image_raw
  kRogueCmdVel,  // publishes /cmd_vel at 20 Hz
  kFlood,        // has many writers, each on a topic of its own
};

struct IntruderCommand {
  dds::DomainOptions domain;
  DdsSettings security;
  IntruderKind kind = IntruderKind::kUnknownNode;
  std::string node = "/intruder";
  // Endpoints only: no node, nothing on `ros_discovery_info`.
  bool anonymous = false;
  // Of kFlood: how many, and whether they are the reply side of services, which no graph shows.
  int64_t writers = 1'000;
  bool replies = false;
  ros2::GidBytes gid_bytes = ros2::GidBytes::k24;
};
// {"event":"flooded","writers":1000}                 all writers of kFlood are there
// {"event":"announced","node":"/intruder"}           the node stands on ros_discovery_info
// {"event":"first_sample","topic":"/cmd_vel"}        time taken just before the write (rogue)
//                                                    or on reception (unknown node)
absl::Status RunIntruder(const IntruderCommand& command, StopFlag& stop);

struct RivalCommand {
  dds::DomainOptions domain;
  // The robot whose parts it serves, too.
  std::string smh_file;
  std::string system = "/safety";
  // It forges heartbeats of the clients of these parts that it sees, to the robot's servers, which
  // then drop what these clients send: once of each that is there when it starts, or of every one
  // again and again.
  bool deafen = false;
  bool deafen_always = false;
};
// A process without a node that serves every part of a robot: it takes each order, is in the mode
// at once, and publishes nothing.
// {"event":"rival","clients":24}   it serves, and has forged heartbeats of so many clients
absl::Status RunRival(const RivalCommand& command, StopFlag& stop);

struct ProbeCommand {
  dds::DomainOptions domain;
  DdsSettings security;
  std::string topic = "/camera/image_raw";
  std::string type = "sensor_msgs/msg/Image";
  absl::Duration window = absl::Seconds(1);
  // Windows to measure; 0 = until stopped.
  int64_t count = 0;
  // Announce this node; empty = a plain DDS participant.
  std::string node;
};
// {"event":"ready","topic":...}
// {"event":"rate","topic":...,"hz":15.0,"samples":15,"window_ms":1000,"last_sample_unix_ns":...}
absl::Status RunProbe(const ProbeCommand& command, StopFlag& stop);

struct ObserveCommand {
  dds::DomainOptions domain;
  std::string node = "/recorder";
};
// What a robot with a floor lets others see; each is printed with when it came.
// {"event":"ready"}
// {"event":"frame"}                                      a picture
// {"event":"cells","free":1662,"occupied":39720}         the costmap
// {"event":"pose","x":1.0,"y":5.2,"speed":0.3}           odometry: metres, m/s
// {"event":"twist"}                                      a command to the base
absl::Status RunObserve(const ObserveCommand& command, StopFlag& stop);

struct PublishCommand {
  dds::DomainOptions domain;
  DdsSettings security;
  std::string node = "/load";
  std::string topic = "/load";
  std::string type = "std_msgs/msg/String";
  // Messages a second, and bytes of each after the CDR header.
  int64_t rate = 2'000;
  int64_t bytes = 64;
  // Messages to send; 0 = until stopped.
  int64_t count = 0;
  // Readers to wait for.
  int64_t readers = 1;
};
// Publishes from when enough of them read; then waits to be stopped.
// {"event":"publishing","topic":...}
// {"event":"published","sent":4000}
absl::Status RunPublish(const PublishCommand& command, StopFlag& stop);

struct ModeCommand {
  dds::DomainOptions domain;
  DdsSettings security;
  std::string part = "/safety";
  // For `mode`: also read back the nodes of the part named here, if given.
  std::string smh_file;
  // For `set-mode`.
  std::string mode;
  // For discovery and the answer, per service.
  absl::Duration timeout = absl::Seconds(5);
  // For `set-mode`: how long to wait for get_mode to give the mode; zero = do not ask.
  absl::Duration wait = absl::ZeroDuration();
};
// {"event":"mode_of","part":"/safety","mode":"ALERT","state":"active","available":[...],
//  "parts":[{"part":"/camera","state":"inactive","parameters":{"frame_rate":"15"}},...]}
absl::Status RunMode(const ModeCommand& command, StopFlag& stop);
// {"event":"set_mode","part":"/safety","mode":"ALERT","success":true}
// {"event":"reached","part":"/safety","mode":"ALERT"}
// FailedPrecondition if the answer is no; DeadlineExceeded if the mode was not reached.
absl::Status RunSetMode(const ModeCommand& command, StopFlag& stop);

// What a process joins its domain as: keystore and enclave of `security`, if there is a keystore.
absl::StatusOr<dds::ParticipantOptions> Identity(const DdsSettings& security);

// The file's text. NotFound if it cannot be read.
absl::StatusOr<std::string> ReadFile(const std::string& path);

}  // namespace rips::robot_sim

#endif  // RIPS_TESTS_SUPPORT_ROBOT_SIM_COMMANDS_H_
