#include "policy_server/server/config/config.h"

#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/status_matchers.h"

namespace rips::server {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

constexpr char kShort[] = R"(id: ps1
trust_domain: fleet.example
tls: {ca: /p/ca.pem, cert: /p/cert.pem, key: /p/key.pem}
)";

constexpr char kFull[] = R"(id: ps1
listen: "127.0.0.1:0"
trust_domain: fleet.example
tls: {ca: /p/ca.pem, cert: /p/cert.pem, key: /p/key.pem}
inventory: /e/robots.yaml
bundles: {source: /e/bundles, dir: /v/bundles, keys: [/k/alice.pem, /k/bob.pem]}
store: {kind: sqlite, path: /v/state.db}
alerts: {file: /l/alerts.jsonl, rotate_bytes: 1MiB, keep: 3}
timing: {heartbeat: 100ms, stale: 300ms, lost: 1s, lease: 3s, drain_lease: 10s, late_after: 2s, linger: 0ms, tick: 50ms}
shards: 3
plugins: {user: detectors, readable: [/opt/detectors, /srv/models], helpers: /opt/rips/bin}
metrics: "127.0.0.1:0"
connections: {total: 100, reserve: 10, per_network: 50, per_address: 20}
fairness: {cpu_per_second: 100ms, cpu_burst: 1s, long_task: 5ms}
operators: {streams: 2, calls: 3, calls_per_second: 4}
)";

TEST(ServerConfigTest, FillsInTheDefaults) {
  const auto parsed = ParseServerConfig("ps.yaml", kShort);
  ASSERT_THAT(parsed, IsOk());
  ServerConfig expected;
  expected.id = "ps1";
  expected.trust_domain = "fleet.example";
  expected.tls = {.ca = "/p/ca.pem", .cert = "/p/cert.pem", .key = "/p/key.pem"};
  expected.recordings_dir = "/var/lib/rips/policy-server/recordings";
  EXPECT_EQ(parsed->config, expected);
  EXPECT_EQ(expected.timing.lease, absl::Seconds(15));
  EXPECT_THAT(FormatSettings(parsed->settings),
              AllOf(HasSubstr("timing.lease: 15s"), HasSubstr("listen: \"0.0.0.0:7443\""),
                    HasSubstr("bundles.keys: []")));
}

TEST(ServerConfigTest, CertificatesAreSignedByAKeyOrByAProgram) {
  EXPECT_FALSE(ParseServerConfig("ps.yaml", kShort)->config.enrolment.enabled());
  const auto key =
      ParseServerConfig("ps.yaml", absl::StrCat(kShort, "enrolment: {cert: /c, key: /k}\n"));
  ASSERT_THAT(key, IsOk());
  EXPECT_TRUE(key->config.enrolment.enabled());
  EXPECT_EQ(key->config.enrolment.external_ca, ExternalCaConfig{});
  const auto program = ParseServerConfig(
      "ps.yaml", absl::StrCat(kShort,
                              "enrolment: {external_ca: {program: [/sign, -x, /ca], timeout: 30s}, "
                              "life: 7d}\n"));
  ASSERT_THAT(program, IsOk());
  const EnrolmentConfig& enrolment = program->config.enrolment;
  EXPECT_TRUE(enrolment.enabled());
  EXPECT_EQ(enrolment.cert, "");
  EXPECT_EQ(enrolment.external_ca.program, (std::vector<std::string>{"/sign", "-x", "/ca"}));
  EXPECT_EQ(enrolment.external_ca.timeout, absl::Seconds(30));
  EXPECT_EQ(enrolment.life, absl::Hours(24 * 7));
}

TEST(ServerConfigTest, HasALimitOfBundleKeys) {
  std::string keys = "/k/0.pem";
  for (size_t i = 1; i < kBundleKeysMax; ++i) absl::StrAppend(&keys, ", /k/", i, ".pem");
  const auto with = [](const std::string& list) {
    return ParseServerConfig("ps.yaml", absl::StrCat(kShort, "bundles: {keys: [", list, "]}\n"));
  };
  ASSERT_THAT(with(keys), IsOk());
  EXPECT_EQ(with(keys)->config.bundle_keys.size(), kBundleKeysMax);
  EXPECT_THAT(with(absl::StrCat(keys, ", /k/more.pem")),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("33 keys exceed limit 32")));
}

TEST(ServerConfigTest, PluginsAreKeptFromRootAndFromAllFiles) {
  const auto parsed = ParseServerConfig(
      "ps.yaml", absl::StrCat(kShort, "plugins: {user: root, readable: [/, opt], helpers: bin}\n"));
  EXPECT_THAT(parsed,
              StatusIs(absl::StatusCode::kInvalidArgument,
                       AllOf(HasSubstr("`user` is root"), HasSubstr("`readable` has `/`"),
                             HasSubstr("`readable` has `opt`"), HasSubstr("`helpers` is `bin`"))));
}

TEST(ServerConfigTest, ReadsEveryKey) {
  const auto parsed = ParseServerConfig("ps.yaml", kFull);
  ASSERT_THAT(parsed, IsOk());
  const ServerConfig& config = parsed->config;
  EXPECT_EQ(config.listen, "127.0.0.1:0");
  EXPECT_EQ(config.inventory, "/e/robots.yaml");
  EXPECT_EQ(config.bundles_source, "/e/bundles");
  EXPECT_EQ(config.bundles_dir, "/v/bundles");
  EXPECT_EQ(config.bundle_keys, (std::vector<std::string>{"/k/alice.pem", "/k/bob.pem"}));
  EXPECT_THAT(FormatSettings(parsed->settings),
              HasSubstr("bundles.keys: [\"/k/alice.pem\", \"/k/bob.pem\"]"));
  EXPECT_EQ(config.store_path, "/v/state.db");
  EXPECT_EQ(config.recordings_directory(), "/v/recordings") << "beside it";
  EXPECT_EQ(config.recordings_bytes, 256u << 20);
  EXPECT_EQ(config.alerts.path, "/l/alerts.jsonl");
  EXPECT_EQ(config.alerts.rotate_bytes, 1u << 20);
  EXPECT_EQ(config.alerts.keep, 3);
  EXPECT_EQ(config.plugin_user, "detectors");
  EXPECT_EQ(config.plugin_readable, (std::vector<std::string>{"/opt/detectors", "/srv/models"}));
  EXPECT_EQ(config.plugin_helpers, "/opt/rips/bin");
  EXPECT_EQ(config.timing, (Timing{.heartbeat = absl::Milliseconds(100),
                                   .stale = absl::Milliseconds(300),
                                   .lost = absl::Seconds(1),
                                   .lease = absl::Seconds(3),
                                   .drain_lease = absl::Seconds(10),
                                   .late_after = absl::Seconds(2),
                                   .linger = absl::ZeroDuration(),
                                   .tick = absl::Milliseconds(50)}));
  EXPECT_EQ(config.connections,
            (rpc::AdmissionLimits{
                .total = 100, .reserve = 10, .per_network = 50, .per_address = 20, .burst = 20}));
  EXPECT_EQ(config.fairness, (Fairness{.cpu_per_second = absl::Milliseconds(100),
                                       .cpu_burst = absl::Seconds(1),
                                       .long_task = absl::Milliseconds(5)}));
  EXPECT_EQ(config.operators, (OperatorQuota{.streams = 2, .calls = 3, .calls_per_second = 4}));
  EXPECT_EQ(config.shards, 3);
  EXPECT_EQ(config.metrics, "127.0.0.1:0");
}

struct BadCase {
  std::string name;
  std::string from;  // text of kFull
  std::string to;
  std::string message;
};

class BadServerConfigTest : public testing::TestWithParam<BadCase> {};

TEST_P(BadServerConfigTest, IsRefusedWithItsPlace) {
  const std::string text = absl::StrReplaceAll(kFull, {{GetParam().from, GetParam().to}});
  ASSERT_NE(text, kFull);
  EXPECT_THAT(ParseServerConfig("ps.yaml", text),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr(GetParam().message)));
}

INSTANTIATE_TEST_SUITE_P(
    All, BadServerConfigTest,
    testing::Values(
        BadCase{"UnknownKey", "shards: 3", "shard: 3", "ps.yaml:10:1: unknown key `shard`; "},
        BadCase{"NoId", "id: ps1\n", "", "missing key `id`"},
        BadCase{"BadId", "id: ps1", "id: PS1", "`PS1` is not a valid policy server id"},
        BadCase{"BadListen", "\"127.0.0.1:0\"\ntrust", "nowhere\ntrust", "write `HOST:PORT`"},
        BadCase{"BadTrustDomain", "fleet.example", "spiffe://x", "is not a trust domain"},
        BadCase{"NoKey", ", key: /p/key.pem", "", "missing key `tls.key`"},
        BadCase{"RelativePath", "/v/state.db", "state.db", "write an absolute path"},
        BadCase{"RelativeBundles", "/e/bundles", "bundles", "write an absolute path"},
        BadCase{"RelativeBundleKey", "/k/bob.pem", "bob.pem",
                "`keys` has `bob.pem`; write the abs"},
        BadCase{"EmptyBundleKey", "/k/bob.pem", "\"\"", "`keys` has ``; write the absolute path"},
        BadCase{"BundleKeyTwice", "/k/bob.pem", "/k/alice.pem", "`/k/alice.pem` is listed twice"},
        BadCase{"BundleKeyAlone", "[/k/alice.pem, /k/bob.pem]", "/k/alice.pem", "write a list"},
        BadCase{"BundleKeyMapping", "[/k/alice.pem, /k/bob.pem]", "{a: /k/a.pem}", "write a list"},
        BadCase{"BundleKeyList", "/k/bob.pem", "[/k/bob.pem]", "must be a list of texts"},
        BadCase{"BundleKeysMistyped", "keys: [", "key: [", "unknown key `key`"},
        BadCase{"RotateTooLittle", "rotate_bytes: 1MiB", "rotate_bytes: 63KiB", "less than 64KiB"},
        BadCase{"RotateTooMuch", "rotate_bytes: 1MiB", "rotate_bytes: 1025GiB", "`rotate_bytes`"},
        BadCase{"RotateNoUnit", "rotate_bytes: 1MiB", "rotate_bytes: 100000", "`rotate_bytes`"},
        BadCase{"KeepNone", "keep: 3", "keep: 0", "it must be from 1 to 100"},
        BadCase{"KeepTooMany", "keep: 3", "keep: 101", "it must be from 1 to 100"},
        BadCase{"KeepAlone", "rotate_bytes: 1MiB, ", "", "`keep` does nothing without"},
        BadCase{"KeepNothingRotated", "rotate_bytes: 1MiB", "rotate_bytes: 0B",
                "`keep` does nothing without"},
        BadCase{"OtherStore", "kind: sqlite", "kind: etcd", "`kind` is `etcd`; write `sqlite`"},
        BadCase{"BareNumber", "lost: 1s", "lost: 1", "is not a duration"},
        BadCase{"StaleTooShort", "stale: 300ms", "stale: 100ms",
                "`stale` (100ms) must be longer than `heartbeat` (100ms)"},
        BadCase{"StaleAfterOneHeartbeat", "stale: 300ms", "stale: 199ms",
                "`stale` (199ms) must be at least twice `heartbeat` (100ms)"},
        BadCase{"LostTooShort", "lost: 1s", "lost: 200ms",
                "`lost` (200ms) must be longer than `stale` (300ms)"},
        BadCase{"LeaseTooShort", "lease: 3s", "lease: 1s",
                "`lease` (1s) must be longer than `lost` (1s)"},
        BadCase{"DrainTooShort", "drain_lease: 10s", "drain_lease: 2s",
                "`drain_lease` (2s) must not be shorter than `lease` (3s)"},
        BadCase{"ReserveOfAll", "reserve: 10", "reserve: 100",
                "`reserve` (100) must be less than `total` (100)"},
        BadCase{"NoConnections", "total: 100", "total: 0", "`total`"},
        BadCase{"NoShards", "shards: 3", "shards: 0", "write `auto` or a number from 1 to 64"},
        BadCase{"TooManyShards", "shards: 3", "shards: 65", "write `auto` or a number"},
        BadCase{"WordShards", "shards: 3", "shards: many", "`shards` is `many`"},
        BadCase{"AuditPath", "shards: 3", "audit: {dir: audit}", "write an absolute path"},
        BadCase{"RecordingsPath", "shards: 3", "recordings: {dir: here}", "write an absolute path"},
        BadCase{"RecordingsFew", "shards: 3", "recordings: {keep: 64KiB}", "write more, or `0B`"},
        BadCase{"RecordingsKeep", "shards: 3", "recordings: {keep: -1MiB}", "`keep`"},
        BadCase{"EnrolmentEmpty", "shards: 3", "enrolment: {life: 30d}",
                "needs `cert` and `key`, the issuing certificate and its key, or `external_ca`"},
        BadCase{"EnrolmentNoKey", "shards: 3", "enrolment: {cert: /c}", "`enrolment.key`"},
        BadCase{"EnrolmentBoth", "shards: 3",
                "enrolment: {cert: /c, key: /k, external_ca: {program: [/sign]}}",
                "either `cert` and `key` sign certificates, or `external_ca` does; remove one"},
        BadCase{"EnrolmentKeyAndProgram", "shards: 3",
                "enrolment: {key: /k, external_ca: {program: [/sign]}}", "remove one of both"},
        BadCase{"ExternalCaNull", "shards: 3", "enrolment: {external_ca: null}", "external_ca"},
        BadCase{"ExternalCaText", "shards: 3", "enrolment: {external_ca: /sign}", "external_ca"},
        BadCase{"ExternalCaNoProgram", "shards: 3", "enrolment: {external_ca: {timeout: 5s}}",
                "`enrolment.external_ca.program`"},
        BadCase{"ExternalCaNoWords", "shards: 3", "enrolment: {external_ca: {program: []}}",
                "program"},
        BadCase{"ExternalCaOneWord", "shards: 3", "enrolment: {external_ca: {program: /sign}}",
                "write a list"},
        BadCase{"ExternalCaRelative", "shards: 3", "enrolment: {external_ca: {program: [sign, x]}}",
                "`program` begins with `sign`; write its absolute path, then its arguments"},
        BadCase{"ExternalCaSlow", "shards: 3",
                "enrolment: {external_ca: {program: [/sign], timeout: 61s}}", "`timeout`"},
        BadCase{"ExternalCaUnknownKey", "shards: 3",
                "enrolment: {external_ca: {program: [/sign], retries: 3}}",
                "unknown key `retries`"},
        BadCase{"AuditSegment", "shards: 3", "audit: {segment: 1KiB}", "`segment`"}),
    [](const testing::TestParamInfo<BadCase>& param) { return param.param.name; });

TEST(ServerConfigTest, ReportsAllProblemsAtOnce) {
  const auto parsed = ParseServerConfig("ps.yaml", "id: PS\nlisten: x\naudit: {dir: a}\n");
  EXPECT_THAT(parsed, StatusIs(absl::StatusCode::kInvalidArgument,
                               AllOf(HasSubstr("policy server id"), HasSubstr("HOST:PORT"),
                                     HasSubstr("write an absolute path"),
                                     HasSubstr("missing key `trust_domain`"),
                                     HasSubstr("missing key `tls`"))));
}

TEST(ServerConfigTest, RefusesATruncatedFileWithoutCrashing) {
  const std::string full = kFull;
  const std::string must_have = "tls: {ca: /p/ca.pem, cert: /p/cert.pem, key: /p/key.pem}";
  const size_t enough = full.find(must_have) + must_have.size();
  for (size_t cut = 0; cut < enough; ++cut) {
    EXPECT_THAT(ParseServerConfig("ps.yaml", full.substr(0, cut)),
                StatusIs(absl::StatusCode::kInvalidArgument))
        << cut;
  }
}

}  // namespace
}  // namespace rips::server
