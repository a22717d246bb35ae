// One process on the bus for tests: a participant that publishes what it is told, honest or not,
// and tells what it hears.
//
//   dds_peer --domain 7 --node /talker --publish rt/chatter,std_msgs::msg::dds_::String_,reliable
//   dds_peer --domain 7 --hear rt/chatter,std_msgs::msg::dds_::String_
//
// Prints `up PREFIX` (its GUID prefix, 24 hexadecimal digits), `matched` once every writer has its
// readers, `written` when all were written but the tail, and `sent TOPIC COUNT` for each topic at
// the end; with --hear five times a second `heard` and for each participant so far
// `PREFIX=SAMPLES/NEWEST`, the newest by the writer's numbers. SIGTERM ends it in order; SIGKILL is
// a crash. With --withhold 10.0.0.1:17417 nothing goes out to that place: who listens there is left
// out.
#include <algorithm>
#include <csignal>
#include <cstdio>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "CLI/CLI.hpp"
#include "absl/base/thread_annotations.h"
#include "absl/strings/escaping.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "absl/strings/strip.h"
#include "absl/time/clock.h"
#include "services/base/status_macros.h"
#include "services/dds/participant.h"
#include "services/dds/raw_reader.h"
#include "services/dds/raw_writer.h"
#include "services/dds/security.h"
#include "services/ros2/cdr.h"
#include "services/ros2/discovery_info.h"
#include "services/ros2/ros_name.h"
#include "services/runtime/mutex.h"
#include "services/runtime/shutdown.h"
#include "tests/support/dds_peer/lawless.h"
#include "tests/support/dds_peer/withhold.h"
#include "tests/support/robot_sim/stop_flag.h"

namespace rips::dds_peer {
namespace {

constexpr size_t kPrefixBytes = 12;
constexpr absl::Duration kHeardPeriod = absl::Milliseconds(200);

struct Options {
  dds::DomainOptions domain;
  // Announced; with a keystore it is proved.
  std::string enclave = "/";
  std::string keystore;
  // ADDRESS:PORT that gets nothing of what is sent there.
  std::string withhold;
  // Does what its permissions forbid.
  bool lawless = false;
  // Of each sample, with the CDR header; empty = a string of `bytes`.
  std::string payload;
  std::vector<std::string> nodes;
  bool long_gids = true;
  // TOPIC,TYPE[,reliable][,latched][,keep_all][,exclusive][,depth=N][,partition=P]
  std::vector<std::string> publish;
  // TOPIC,TYPE[,reliable]; in place of publishing.
  std::string hear;
  size_t bytes = 24;
  // Samples of each topic; 0 = until it is ended.
  uint64_t count = 0;
  int64_t period_us = 20'000;
  // After the last, one more so often until it is ended; 0 = end.
  int64_t tail_ms = 0;
  // Readers that each writer waits for before it writes.
  size_t readers = 0;
};

struct Topic {
  std::string name;
  std::unique_ptr<dds::RawWriter> writer;
  uint64_t sent = 0;
};

absl::StatusOr<Topic> MakeTopic(const dds::Participant& participant, const std::string& text) {
  const std::vector<std::string> fields = absl::StrSplit(text, ',');
  if (fields.size() < 2) return absl::InvalidArgumentError("--publish wants TOPIC,TYPE");
  dds::RawWriterOptions options{.topic = fields[0], .type = fields[1], .qos = {.depth = 1}};
  for (size_t i = 2; i < fields.size(); ++i) {
    absl::string_view field = fields[i];
    if (field == "reliable") {
      options.qos.reliable = true;
    } else if (field == "latched") {
      options.qos.reliable = options.qos.transient_local = true;
    } else if (field == "keep_all") {
      options.qos.keep_all = true;
    } else if (field == "exclusive") {
      options.exclusive = true;
    } else if (absl::ConsumePrefix(&field, "partition=")) {
      options.qos.partitions.push_back(std::string(field));
    } else if (!absl::ConsumePrefix(&field, "depth=") ||
               !absl::SimpleAtoi(field, &options.qos.depth)) {
      return absl::InvalidArgumentError(std::string(fields[i]));
    }
  }
  RIPS_ASSIGN_OR_RETURN(auto writer, dds::RawWriter::Create(participant, options));
  return Topic{.name = fields[0], .writer = std::move(writer)};
}

// All writers belong to the first node.
ros2::ParticipantEntities Claim(const dds::Participant& participant, const Options& options,
                                const std::vector<Topic>& topics) {
  ros2::ParticipantEntities claim{
      .participant = participant.guid(),
      .gid_bytes = options.long_gids ? ros2::GidBytes::k24 : ros2::GidBytes::k16};
  for (const std::string& node : options.nodes) {
    const size_t slash = node.rfind('/');
    claim.nodes.push_back({.node_namespace = slash == 0 ? "/" : node.substr(0, slash),
                           .node_name = node.substr(slash + 1)});
  }
  for (const Topic& topic : topics) claim.nodes[0].writers.push_back(topic.writer->guid());
  return claim;
}

// A string of the size that was asked for.
std::string Payload(size_t bytes) {
  ros2::CdrWriter cdr;
  cdr.String(std::string(bytes < 9 ? 0 : bytes - 9, 'x'));
  return std::move(cdr).Finish();
}

void Publish(const Options& options, std::vector<Topic>& topics, robot_sim::StopFlag& stop) {
  const std::string payload = options.payload.empty() ? Payload(options.bytes) : options.payload;
  const absl::Time start = absl::Now();
  // What cannot be written in time is not counted as sent; the writer numbers it all the same.
  const auto write = [&payload](Topic& topic) {
    ++topic.sent;
    topic.writer->Write(payload).IgnoreError();
  };
  for (uint64_t i = 0; options.count == 0 || i < options.count; ++i) {
    for (Topic& topic : topics) write(topic);
    // Even a wait for nothing takes some 60 us.
    if (options.period_us == 0 && i % 256 != 0) continue;
    if (stop.WaitFor(absl::Microseconds(options.period_us))) return;
  }
  std::printf("written in %.3f s\n", absl::ToDoubleSeconds(absl::Now() - start));
  std::fflush(stdout);
  while (options.tail_ms > 0 && !stop.WaitFor(absl::Milliseconds(options.tail_ms))) {
    for (Topic& topic : topics) write(topic);
  }
}

std::string PrefixOf(const ros2::Guid& guid) {
  return absl::BytesToHexString(guid.ToBytes().substr(0, kPrefixBytes));
}

// What came from whom, by GUID prefix.
class Heard {
 public:
  void Add(const dds::RawSample& sample) ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    Count& count = counts_[PrefixOf(sample.writer)];
    ++count.samples;
    count.newest = std::max(count.newest, sample.writer_sequence);
  }
  std::string Line() const ABSL_LOCKS_EXCLUDED(mu_) {
    std::string line = "heard";
    MutexLock lock(&mu_);
    for (const auto& [prefix, count] : counts_) {
      absl::StrAppend(&line, " ", prefix, "=", count.samples, "/", count.newest);
    }
    return line;
  }

 private:
  struct Count {
    uint64_t samples = 0;
    uint64_t newest = 0;
  };
  mutable Mutex mu_;
  std::map<std::string, Count> counts_ ABSL_GUARDED_BY(mu_);
};

absl::Status Hear(const dds::Participant& participant, const std::string& text,
                  robot_sim::StopFlag& stop) {
  const std::vector<std::string> fields = absl::StrSplit(text, ',');
  if (fields.size() < 2 || fields.size() > 3 || (fields.size() == 3 && fields[2] != "reliable")) {
    return absl::InvalidArgumentError("--hear wants TOPIC,TYPE[,reliable]");
  }
  Heard heard;
  RIPS_ASSIGN_OR_RETURN(
      const auto reader,
      dds::RawReader::Create(
          participant,
          {.topic = fields[0], .type = fields[1], .reliable = fields.size() == 3, .depth = 10'000},
          [&heard](const dds::RawSample& sample) { heard.Add(sample); }));
  while (!stop.WaitFor(kHeardPeriod)) {
    std::printf("%s\n", heard.Line().c_str());
    std::fflush(stdout);
  }
  return absl::OkStatus();
}

absl::Status Run(const Options& options, robot_sim::StopFlag& stop) {
  RIPS_ASSIGN_OR_RETURN(
      std::optional<dds::Enclave> security,
      dds::LoadSecurity({.keystore = options.keystore, .enclave = options.enclave}, absl::Now()));
  if (options.lawless) IgnoreOwnPermissions();
  if (!options.withhold.empty()) RIPS_RETURN_IF_ERROR(Withhold(options.withhold));
  RIPS_ASSIGN_OR_RETURN(auto domain, dds::Domain::Create(options.domain));
  RIPS_ASSIGN_OR_RETURN(auto participant,
                        dds::Participant::Create(
                            domain, {.enclave = options.enclave, .security = std::move(security)}));
  std::vector<Topic> topics;
  for (const std::string& text : options.publish) {
    RIPS_ASSIGN_OR_RETURN(Topic topic, MakeTopic(*participant, text));
    topics.push_back(std::move(topic));
  }
  std::unique_ptr<dds::RawWriter> info;
  if (!options.nodes.empty()) {
    RIPS_ASSIGN_OR_RETURN(
        info, dds::RawWriter::Create(
                  *participant, {.topic = ros2::kDiscoveryTopic,
                                 .type = ros2::kDiscoveryType,
                                 .qos = {.reliable = true, .transient_local = true, .depth = 1}}));
    RIPS_RETURN_IF_ERROR(
        info->Write(ros2::EncodeParticipantEntities(Claim(*participant, options, topics))));
  }
  std::printf("up %s\n", PrefixOf(participant->guid()).c_str());
  std::fflush(stdout);
  if (!options.hear.empty()) return Hear(*participant, options.hear, stop);
  for (const Topic& topic : topics) {
    while (topic.writer->MatchedReaders() < options.readers) {
      if (stop.WaitFor(absl::Milliseconds(1))) return absl::OkStatus();
    }
  }
  std::printf("matched\n");
  std::fflush(stdout);
  if (topics.empty()) {
    while (!stop.WaitFor(absl::Seconds(1))) {
    }
  }
  Publish(options, topics, stop);
  for (const Topic& topic : topics) {
    std::printf("sent %s %llu\n", topic.name.c_str(), static_cast<unsigned long long>(topic.sent));
  }
  return absl::OkStatus();
}

int Main(int argc, char** argv) {
  Options options;
  CLI::App app("a process on the bus");
  app.add_option("--domain", options.domain.id)->required();
  app.add_option("--interface", options.domain.interface)->default_val("lo");
  app.add_option("--enclave", options.enclave);
  app.add_option("--keystore", options.keystore);
  app.add_option("--withhold", options.withhold);
  app.add_flag("--lawless", options.lawless);
  app.add_option_function<std::string>("--payload", [&options](const std::string& hex) {
    options.payload = absl::HexStringToBytes(hex);
  });
  app.add_option("--node", options.nodes);
  app.add_flag("--short-gids{false}", options.long_gids);
  CLI::Option* publish = app.add_option("--publish", options.publish);
  app.add_option("--hear", options.hear)->excludes(publish);
  app.add_option("--bytes", options.bytes);
  app.add_option("--count", options.count);
  app.add_option("--period-us", options.period_us);
  app.add_option("--tail-ms", options.tail_ms);
  app.add_option("--readers", options.readers);
  CLI11_PARSE(app, argc, argv);
  BlockSignals();
  robot_sim::StopFlag stop;
  SignalWaiter signals({{SIGTERM, [&stop] { stop.Stop(); }}});
  const absl::Status status = Run(options, stop);
  if (status.ok()) return 0;
  std::fprintf(stderr, "%s\n", status.ToString().c_str());
  return 1;
}

}  // namespace
}  // namespace rips::dds_peer

int main(int argc, char** argv) { return rips::dds_peer::Main(argc, argv); }
