// policy-server.yaml: what the policy server is told at start.
#ifndef RIPS_POLICY_SERVER_SERVER_CONFIG_CONFIG_H_
#define RIPS_POLICY_SERVER_SERVER_CONFIG_CONFIG_H_

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "policy_server/server/config/output_config.h"
#include "services/rpc/connection_admission.h"
#include "services/runtime/config_sections.h"

namespace rips::server {

inline constexpr int kShardsMax = 64;
inline constexpr size_t kBundleKeysMax = 32;
inline constexpr char kPluginUser[] = "rips-plugin";

// Ordered: heartbeat < stale < lost < lease <= drain_lease.
struct Timing {
  // How often both ends of a stream say that they live; 50 ms to 10 s. Agents follow it.
  absl::Duration heartbeat = absl::Milliseconds(500);
  // An agent silent for so long is shown as stale, and may be replaced by a second session.
  absl::Duration stale = absl::Milliseconds(1500);
  // ... is lost: rules are told, and evidence is incomplete.
  absl::Duration lost = absl::Seconds(5);
  // Authority over an actuator, from the sending of the heartbeat that it echoes. When it runs out
  // the actuator goes to its own fail-safe level.
  absl::Duration lease = absl::Seconds(15);
  // Granted when the server shuts down in an orderly way, so that an upgrade stops no robot.
  absl::Duration drain_lease = absl::Seconds(60);
  // An observation judged when older than this is late: it may raise a level, not lower one.
  absl::Duration late_after = absl::Seconds(5);
  // How long a sensor may collect messages before it sends them.
  absl::Duration linger = absl::Milliseconds(20);
  // How often External rules run when nothing happens.
  absl::Duration tick = absl::Milliseconds(200);

  friend bool operator==(const Timing&, const Timing&) = default;
};

// A program that signs certificates (enrol::ExternalCa).
struct ExternalCaConfig {
  // An absolute path, then arguments. Empty: there is none.
  std::vector<std::string> program;
  // 1 to 60 s.
  absl::Duration timeout = absl::Seconds(10);

  friend bool operator==(const ExternalCaConfig&, const ExternalCaConfig&) = default;
};

// Certificates that the server issues to agents: by its own key, or by a program.
struct EnrolmentConfig {
  // PEM, absolute paths: the issuing certificate with those between it and the root, and its key.
  // Both empty: the key does not sign.
  std::string cert;
  std::string key;
  ExternalCaConfig external_ca;
  // Of a certificate; 6 hours to two years: agents look each hour whether theirs is due.
  absl::Duration life = absl::Hours(24 * 30);

  // False: none are issued.
  bool enabled() const { return !cert.empty() || !external_ca.program.empty(); }

  friend bool operator==(const EnrolmentConfig&, const EnrolmentConfig&) = default;
};

// What one robot may cost the threads that judge.
struct Fairness {
  // CPU time in a second; what its agents send beyond it waits.
  absl::Duration cpu_per_second = absl::Milliseconds(250);
  // So much is saved at most.
  absl::Duration cpu_burst = absl::Milliseconds(500);
  // A robot with a piece of work that costs so much is judged on a thread of its kind.
  absl::Duration long_task = absl::Milliseconds(20);

  friend bool operator==(const Fairness&, const Fairness&) = default;
};

// What one operator's certificate may use (operator_api::QuotaLimits).
struct OperatorQuota {
  int streams = 16;
  int calls = 8;
  int calls_per_second = 20;

  friend bool operator==(const OperatorQuota&, const OperatorQuota&) = default;
};

struct AlertFile {
  // JSON lines.
  std::string path = "/var/log/rips/alerts.jsonl";
  // The server rotates it before it becomes longer; 0: logrotate or an operator does.
  uint64_t rotate_bytes = 0;
  // Rotated files that are kept; 1 to 100.
  int keep = 5;

  friend bool operator==(const AlertFile&, const AlertFile&) = default;
};

struct ServerConfig {
  // A name as in IsValidName.
  std::string id;
  // `HOST:PORT`; port 0 = any.
  std::string listen = "0.0.0.0:7443";
  // Of every certificate this server accepts, its own included.
  std::string trust_domain;
  TlsFiles tls;
  // Paths are absolute.
  // A file, or a directory of files `*.yaml` (bundle::ReadInventory).
  std::string inventory = "/etc/rips/robots.yaml";
  // `bundles_source`/NAME/manifest.yaml is read at start and on SIGHUP.
  std::string bundles_source = "/etc/rips/bundles";
  // Where bundles that were pushed are kept.
  std::string bundles_dir = "/var/lib/rips/policy-server/bundles";
  // Public keys in PEM; with any, a bundle must have a signature of one of them, also one of
  // `bundles_source`. At most kBundleKeysMax, distinct.
  std::vector<std::string> bundle_keys;
  // SQLite file.
  std::string store_path = "/var/lib/rips/policy-server/state.db";
  AlertFile alerts;
  // At most kOutputsMax.
  std::vector<OutputConfig> outputs;
  // Where the audit log is; empty: none is written.
  std::string audit_dir;
  // A segment of it that has so many bytes is followed by the next one.
  uint64_t audit_segment_bytes = 64ull << 20;
  EnrolmentConfig enrolment;
  // Where recordings of what led to alerts are kept; empty: `recordings` beside the store.
  std::string recordings_dir;
  // Of all of them; 0: none are kept.
  uint64_t recordings_bytes = 256ull << 20;
  Timing timing;
  // How many connections are taken from where.
  rpc::AdmissionLimits connections;
  Fairness fairness;
  OperatorQuota operators;
  // Threads that judge; 0 = one a core (`auto`), at most kShardsMax.
  int shards = 0;
  // Whom plugins and YARA scans run as if we are root: a name or a number. Empty: kPluginUser, or
  // `nobody` if there is no such user.
  std::string plugin_user;
  // What plugins may read and execute besides their bundle and the system's programs and libraries.
  std::vector<std::string> plugin_readable;
  // The directory of rips-inspect and rips-scan; empty: that of our own binary.
  std::string plugin_helpers;
  // Where /metrics, /healthz and /readyz are served.
  std::string metrics = "127.0.0.1:9464";

  // `recordings_dir`, or what stands for it.
  std::string recordings_directory() const;
  // `enrolment.db` beside the store: tokens and what was issued.
  std::string enrolment_path() const;

  friend bool operator==(const ServerConfig&, const ServerConfig&) = default;
};

struct ParsedServerConfig {
  ServerConfig config;
  // The effective configuration.
  std::vector<ConfigSetting> settings;
};

// InvalidArgument with every problem and its place. `file` is the name used in messages.
absl::StatusOr<ParsedServerConfig> ParseServerConfig(absl::string_view file,
                                                     absl::string_view text);

}  // namespace rips::server

#endif  // RIPS_POLICY_SERVER_SERVER_CONFIG_CONFIG_H_
