// A small ROS 2 robot on real DDS, its intruders, and what is needed to look at it:
// robot_sim robot|intruder|rival|probe|observe|publish|mode|set-mode; see commands.h.
#include <csignal>
#include <functional>
#include <map>
#include <string>

#include "CLI/CLI.hpp"
#include "services/runtime/log.h"
#include "services/runtime/shutdown.h"
#include "tests/support/robot_sim/commands.h"

namespace rips::robot_sim {
namespace {

// A subcommand fills `run` when it was chosen.
using Run = std::function<absl::Status(StopFlag&)>;

CLI::App* Subcommand(CLI::App& app, const std::string& name, const std::string& about,
                     dds::DomainOptions& domain, std::string& keystore) {
  CLI::App* sub = app.add_subcommand(name, about);
  sub->add_option("--domain", domain.id, "DDS domain id")->required()->check(CLI::Range(0, 232));
  sub->add_option("--interface", domain.interface, "network interface; empty = Cyclone chooses")
      ->default_val("lo");
  sub->add_option("--keystore", keystore, "DDS Security with this keystore");
  return sub;
}

CLI::App* Subcommand(CLI::App& app, const std::string& name, const std::string& about,
                     dds::DomainOptions& domain, DdsSettings& security) {
  CLI::App* sub = Subcommand(app, name, about, domain, security.keystore);
  sub->add_option("--enclave", security.enclave, "its own, such as /talker")->needs("--keystore");
  return sub;
}

void AddMilliseconds(CLI::App* sub, const std::string& name, absl::Duration& value,
                     const std::string& about) {
  sub->add_option_function<int64_t>(
         name, [&value](int64_t ms) { value = absl::Milliseconds(ms); }, about)
      ->check(CLI::Range(1, 3'600'000));
}

void AddGidSize(CLI::App* sub, ros2::GidBytes& gid_bytes) {
  sub->add_option("--gid-size", gid_bytes, "24 as in Humble, 16 as in Iron and later")
      ->transform(CLI::CheckedTransformer(std::map<std::string, ros2::GidBytes>{
          {"16", ros2::GidBytes::k16}, {"24", ros2::GidBytes::k24}}));
}

void AddRobot(CLI::App& app, RobotCommand& command, Run& run) {
  CLI::App* sub = Subcommand(app, "robot", "run the robot", command.domain, command.keystore);
  sub->add_option("--smh", command.smh_file, "System Modes file")->required();
  sub->add_option("--system", command.system, "the system whose modes are switched");
  sub->add_option("--manager-node", command.manager_node, "node that serves the modes");
  sub->add_option("--only", command.only, "parts to run, such as /navigator; all if not given")
      ->delimiter(',');
  const std::map<std::string, ManagerConduct> conducts = {{"honest", ManagerConduct::kHonest},
                                                          {"lie", ManagerConduct::kLie},
                                                          {"deceive", ManagerConduct::kDeceive},
                                                          {"refuse", ManagerConduct::kRefuse},
                                                          {"absent", ManagerConduct::kAbsent}};
  sub->add_option("--manager", command.conduct, "how the mode manager behaves")
      ->transform(CLI::CheckedTransformer(conducts));
  AddMilliseconds(sub, "--transition-ms", command.transition,
                  "from the manager's answer to the mode being reached (150)");
  AddMilliseconds(sub, "--answer-ms", command.answer_delay,
                  "how long change_mode takes to answer (0)");
  AddGidSize(sub, command.gid_bytes);
  sub->add_option("--image-width", command.image.width, "pixels of the camera's pictures (160)")
      ->check(CLI::Range(1, 4'096));
  sub->add_option("--image-height", command.image.height, "(120)")->check(CLI::Range(1, 4'096));
  sub->add_option("--control", command.control, "named pipe to make, for orders to the robot");
  sub->add_option("--floor", command.floor_file, "where it drives; empty = straight ahead");
  sub->add_option("--speed", command.speed, "how many times as fast its time runs (1)")
      ->check(CLI::Range(0.1, 20.0));
  sub->add_flag("--bad-discovery", command.bad_discovery,
                "also send malformed and foreign discovery messages")
      ->excludes("--keystore");
  sub->callback([&] { run = [&command](StopFlag& stop) { return RunRobot(command, stop); }; });
}

void AddIntruder(CLI::App& app, IntruderCommand& command, Run& run) {
  CLI::App* sub = Subcommand(app, "intruder", "run an intruder", command.domain, command.security);
  const std::map<std::string, IntruderKind> kinds = {{"unknown-node", IntruderKind::kUnknownNode},
                                                     {"rogue-cmd-vel", IntruderKind::kRogueCmdVel},
                                                     {"flood", IntruderKind::kFlood}};
  sub->add_option("--mode", command.kind, "unknown-node, rogue-cmd-vel or flood")
      ->required()
      ->transform(CLI::CheckedTransformer(kinds));
  sub->add_option("--node", command.node, "its node name");
  sub->add_option("--writers", command.writers, "of a flood (1000)")->check(CLI::Range(1, 100'000));
  sub->add_flag("--replies", command.replies, "of a flood: reply sides of services");
  sub->add_flag("--anonymous", command.anonymous, "endpoints without a node");
  AddGidSize(sub, command.gid_bytes);
  sub->callback([&] { run = [&command](StopFlag& stop) { return RunIntruder(command, stop); }; });
}

void AddRival(CLI::App& app, RivalCommand& command, Run& run) {
  CLI::App* sub = app.add_subcommand("rival", "serve the parts of a robot beside it");
  sub->add_option("--domain", command.domain.id, "DDS domain id")
      ->required()
      ->check(CLI::Range(0, 100));
  sub->add_option("--interface", command.domain.interface, "network interface")->default_val("lo");
  sub->add_option("--smh", command.smh_file, "the robot's System Modes file")->required();
  sub->add_option("--system", command.system, "the system whose modes are switched");
  sub->add_flag("--deafen", command.deafen, "make the robot's servers deaf to clients, once");
  sub->add_flag("--deafen-always", command.deafen_always, "also to those that come, and again");
  sub->callback([&] { run = [&command](StopFlag& stop) { return RunRival(command, stop); }; });
}

void AddProbe(CLI::App& app, ProbeCommand& command, Run& run) {
  CLI::App* sub =
      Subcommand(app, "probe", "measure the rate of a topic", command.domain, command.security);
  sub->add_option("--topic", command.topic, "ROS topic");
  sub->add_option("--type", command.type, "ROS type");
  AddMilliseconds(sub, "--window-ms", command.window, "length of a measurement (1000)");
  sub->add_option("--count", command.count, "measurements; 0 = until stopped");
  sub->add_option("--node", command.node, "look like this ROS node; empty = plain DDS");
  sub->callback([&] { run = [&command](StopFlag& stop) { return RunProbe(command, stop); }; });
}

void AddObserve(CLI::App& app, ObserveCommand& command, Run& run) {
  CLI::App* sub = app.add_subcommand("observe", "tell what a robot with a floor lets others see");
  sub->add_option("--domain", command.domain.id, "DDS domain id")
      ->required()
      ->check(CLI::Range(0, 232));
  sub->add_option("--interface", command.domain.interface,
                  "network interface; empty = Cyclone chooses")
      ->default_val("lo");
  sub->add_option("--node", command.node, "its node name");
  sub->callback([&] { run = [&command](StopFlag& stop) { return RunObserve(command, stop); }; });
}

void AddPublish(CLI::App& app, PublishCommand& command, Run& run) {
  CLI::App* sub =
      Subcommand(app, "publish", "publish messages at a rate", command.domain, command.security);
  sub->add_option("--node", command.node, "node name");
  sub->add_option("--topic", command.topic, "ROS topic");
  sub->add_option("--type", command.type, "ROS type");
  sub->add_option("--rate", command.rate, "messages a second")->check(CLI::Range(1, 100'000));
  sub->add_option("--bytes", command.bytes, "bytes of each")->check(CLI::Range(1, 60'000));
  sub->add_option("--count", command.count, "messages; 0 = until stopped");
  sub->add_option("--readers", command.readers, "readers to wait for (1)")
      ->check(CLI::Range(0, 99));
  sub->callback([&] { run = [&command](StopFlag& stop) { return RunPublish(command, stop); }; });
}

void AddModes(CLI::App& app, ModeCommand& command, Run& run) {
  CLI::App* get =
      Subcommand(app, "mode", "read the mode of a part back", command.domain, command.security);
  CLI::App* set = Subcommand(app, "set-mode", "order a mode", command.domain, command.security);
  for (CLI::App* sub : {get, set}) {
    sub->add_option("--part", command.part, "a system or a node");
    AddMilliseconds(sub, "--timeout-ms", command.timeout, "for each service call (5000)");
  }
  get->add_option("--smh", command.smh_file, "also read back the nodes of the part in this file");
  set->add_option("--mode", command.mode, "the mode")->required();
  AddMilliseconds(set, "--wait-ms", command.wait, "wait until get_mode gives the mode");
  get->callback([&] { run = [&command](StopFlag& stop) { return RunMode(command, stop); }; });
  set->callback([&] { run = [&command](StopFlag& stop) { return RunSetMode(command, stop); }; });
}

int Main(int argc, char** argv) {
  RobotCommand robot;
  IntruderCommand intruder;
  RivalCommand rival;
  ProbeCommand probe;
  ObserveCommand observe;
  PublishCommand publish;
  ModeCommand mode;
  Run run;
  CLI::App app("A simulated ROS 2 robot on DDS.");
  app.require_subcommand(1);
  AddRobot(app, robot, run);
  AddIntruder(app, intruder, run);
  AddRival(app, rival, run);
  AddProbe(app, probe, run);
  AddObserve(app, observe, run);
  AddPublish(app, publish, run);
  AddModes(app, mode, run);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? 0 : 2;
  }
  BlockSignals();
  StopFlag stop;
  SignalWaiter signals({{SIGTERM, [&stop] { stop.Stop(); }}, {SIGINT, [&stop] { stop.Stop(); }}});
  const absl::Status status = run(stop);
  if (!status.ok()) {
    LogError("failed", {{"error", status.message()}});
    return 1;
  }
  return 0;
}

}  // namespace
}  // namespace rips::robot_sim

int main(int argc, char** argv) { return rips::robot_sim::Main(argc, argv); }
